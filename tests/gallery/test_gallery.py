"""Every picture of the gallery, drawn small."""

from __future__ import annotations

from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from profiling.gallery import CATALOG, Fact, draw, names, parameters, write_index, write_page
from profiling.gallery.__main__ import main
from profiling.gallery.projection import Ellipse
from profiling.gallery.write import _rows, contents
from vamgpu.errors import BadInput

PAGES = Path(__file__).parents[2] / "docs"


@pytest.mark.slow
@pytest.mark.parametrize("name", names())
def test_every_entry_runs_and_measures_finite_numbers(name: str, tmp_path: Path) -> None:
    picture = draw(name, quick=True)
    numbers = picture.numbers()
    assert numbers and all(isfinite(value) for value in numbers.values()), numbers
    image, page = write_page(picture, name, tmp_path)
    with Image.open(image) as opened:
        assert opened.width > 500 and np.asarray(opened.convert("L")).std() > 5
    text = page.read_text(encoding="utf-8")
    assert f"({name}.png)" in text and CATALOG[name] in text
    assert all(fact.shown in text for fact in picture.facts)


def test_the_index_lists_every_entry(tmp_path: Path) -> None:
    text = write_index(tmp_path).read_text(encoding="utf-8")
    assert all(f"(gallery/{name}.md)" in text and f"(gallery/{name}.png)" in text for name in names())


def test_the_pages_of_the_documentation_are_whole_and_small() -> None:
    assert (PAGES / "gallery.md").read_text(encoding="utf-8") == contents()
    images = sorted((PAGES / "gallery").glob("*.png"))
    assert {path.stem for path in images} == set(names())
    assert {path.stem for path in (PAGES / "gallery").glob("*.md")} == set(names())
    sizes = [path.stat().st_size for path in images]
    assert max(sizes) < 150_000 and sum(sizes) < 5_000_000


def test_the_film_of_studio_is_a_minute_long_and_small() -> None:
    film, times, shown = PAGES / "studio.webp", list[int](), set[bytes]()
    with Image.open(film) as opened:
        for number in range(opened.n_frames):  # type: ignore[attr-defined]
            opened.seek(number)
            shown.add(opened.convert("L").resize((32, 20)).tobytes())
            times.append(opened.info["duration"])
    assert 58_000 <= sum(times) <= 62_000 and film.stat().st_size < 1_500_000
    assert len(shown) >= 20 and max(times) < 6_000


def test_parameters_change_the_picture() -> None:
    assert parameters("vial")["radius"] == 12.4
    wide, narrow = (draw("vial", quick=True, radius=r).numbers() for r in (12.4, 10.0))
    printable = next(key for key in wide if key.startswith("printable radius"))
    assert wide[printable] == pytest.approx(12.4 / 1.49962, abs=2e-3)
    assert narrow[printable] == pytest.approx(10.0 / 1.49962, abs=2e-3)


def test_measured_numbers_agree_with_the_paper() -> None:
    vial = {fact.name: fact for fact in draw("vial", quick=True).facts}
    compared = [fact for fact in vial.values() if fact.expected is not None and not fact.bound]
    assert len(compared) >= 2
    for fact in compared:
        assert fact.value == pytest.approx(fact.expected, rel=1e-2)


@pytest.mark.parametrize("name", ["vial", "projection", "transpose"])
def test_measured_numbers_keep_their_bounds(name: str) -> None:
    for fact in draw(name, quick=True).facts:
        if fact.bound and fact.expected is not None:
            assert fact.value <= fact.expected if fact.bound == "≤" else fact.value >= fact.expected, fact


@pytest.mark.parametrize("name, values", [("nothing", {}), ("vial", {"colour": 1.0})])
def test_unknown_names_and_parameters_are_refused(name: str, values: dict[str, Any]) -> None:
    with pytest.raises(BadInput, match="it has"):
        draw(name, None, quick=True, **values)


def test_bars_within_cells_do_not_end_them() -> None:
    assert _rows([("bin", "greatest |I′|"), ("1", "2")]).splitlines()[0] == "| bin | greatest \\|I′\\| |"


def test_a_fact_states_value_expectation_and_difference() -> None:
    fact = Fact("radius", 8.2688, "mm", 4, 8.27, "paper")
    assert fact.shown == "8.269 mm" and fact.wanted == "8.27 mm (paper)" and fact.difference.startswith("-0.0012 mm")
    assert Fact("error", 0.2, "%", expected=0.4, bound="≤").wanted == "≤ 0.4 %"


def test_the_ellipse_of_the_formula_has_its_area() -> None:
    body = Ellipse(0.27, 0.14, 0.093, -0.061, 0.5)
    area = np.pi * body.a * body.b
    assert body.fractions(64).mean() == pytest.approx(area, rel=1e-4)
    r = (np.arange(400) - 199.5) / 400
    sums = body.chords(r, 1 / 400, np.linspace(0.0, 6.0, 7)).sum(axis=1) / 400
    np.testing.assert_allclose(sums, area, rtol=1e-9)


def test_a_picture_of_the_gallery_is_drawn_with_its_parameters(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["vial", "--quick", "--out", str(tmp_path)]
    assert main([*command, "--set", "resin_index=1.4"]) == 0
    assert (tmp_path / "gallery" / "vial.png").stat().st_size > 0 and (tmp_path / "gallery.md").exists()
    assert main([*command, "--set", "nonsense=1"]) == 1
    assert main(["all", "--set", "resin_index=1.4"]) == 1
    assert "name it" in capsys.readouterr().err

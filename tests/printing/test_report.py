"""The report of a small print: everything inside one file, every picture there, every number the proof's."""

from __future__ import annotations

import base64
import html
import json
import re
import subprocess
import sys
import zlib
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from needs import WAIT, browser, optional
from PIL import Image

from vamgpu import Beam, Grid, Projection, Turntable, Vial
from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.errors import StorageError
from vamgpu.printing import charts, pictures, report, summary, surface
from vamgpu.printing.judgement import _joined, judged
from vamgpu.printing.proof import Proof
from vamgpu.printing.simulate import simulate
from vamgpu.printing.verdict import verdict_of
from vamgpu.targets.solid import Solid

GRID = Grid((24, 24, 14), 0.2)
VIAL = Vial(radius=4.0, wall=0.2, resin_index=1.45, wall_index=1.47, bath_index=1.45, absorption=0.05)


class Shown:
    """Frames that are nothing but their light."""

    bits, scale = 8, 3.0

    def __init__(self, light: np.ndarray) -> None:
        self.light = light

    def irradiance(self, device: Device) -> DeviceArray:
        return device.upload(self.light)


@dataclass(frozen=True)
class Record:
    projector_pairs: int
    loss: float
    window: float | None


def ball(shape: tuple[int, int, int], radius: float = 0.6) -> np.ndarray:
    x, y, z = np.meshgrid(*(np.linspace(-1, 1, n) for n in shape), indexing="ij")
    return np.clip((radius - np.sqrt(x**2 + y**2 + z**2)) * 8 + 0.5, 0, 1)


def small_proof(name: str = "ball <1>", vessel: Vial | None = VIAL) -> Proof:
    A = Projection(GRID, Beam((24, 14), 0.2), Turntable(12), vessel, "numpy")
    light = np.asarray(A(ball(GRID.shape)))
    target = SimpleNamespace(name=name, on=lambda device: device.upload(ball(GRID.shape)))
    return simulate(A, Shown(3 * light / light.max()), target, irradiance=5, critical_dose=1,
                    absorption=None if vessel else 0.1)  # fmt: skip


@pytest.fixture(scope="module")
def proof() -> Proof:
    return small_proof()


@pytest.fixture(scope="module")
def judgement(proof: Proof) -> Any:
    return judged(proof)


PLAN = SimpleNamespace(
    history=tuple(Record(k, 1 / (k + 1), None if k % 2 else 0.01 * k) for k in range(6)),
    method="two thresholds", papers=("A. Author, A method. A Journal 1 (2020) 1.",), seconds=1.5,
)  # fmt: skip


@pytest.fixture(scope="module")
def path(proof: Proof, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The report of a print and its plan, in a folder of its own."""
    return proof.report(tmp_path_factory.mktemp("report") / "proof.html", plan=PLAN)


@pytest.fixture(scope="module")
def unplanned(proof: Proof, judgement: Any) -> Any:
    """The page of a print without a plan."""
    return report.page_of(proof, None, judgement)


@pytest.fixture(scope="module")
def page(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def data_of(page: str) -> dict:
    found = re.search(r"const DATA = (\{.*\});</script>", page)
    assert found
    return json.loads(found[1])


def test_the_page_is_one_file_and_complete(proof: Proof, path: Path, page: str) -> None:
    assert [entry.name for entry in path.parent.iterdir()] == ["proof.html"]
    assert "ball &lt;1&gt;" in page and "<1>" not in page
    assert not re.findall(r"""(?:src|href)=["'](?!data:|#)[^"']*["']""", page)
    assert "@import" not in page and "url(http" not in page
    for heading in ("Window over tolerance", "Sensitivity to errors", "Printed part", "Slices", "Slice by slice",
                    "Dose inside and outside", "Sinogram", "Frames", "Convergence", "Numbers",
                    "Papers relied on"):  # fmt: skip
        assert heading in page
    for text in (*PLAN.papers, "two thresholds", proof.operator.device.description):
        assert text in page
    assert page.count("<svg") == 4
    for line in proof.lines():
        assert line.name in page


def blocks(page: str) -> list[str]:
    """The text of the page's headings, in their order."""
    return re.findall(r"<h2>(.*?)</h2>", page)


def test_the_page_opens_with_what_the_verdict_rests_on(proof: Proof, judgement: Any, unplanned: Any) -> None:
    page, verdict = unplanned.html(), verdict_of(proof, judgement)
    assert blocks(page)[:4] == [
        "Window over tolerance", "Sensitivity to errors", "Surface of the print against the mesh", "Printed part",
    ]  # fmt: skip
    figures = {figure.name: figure.value for figure in summary.headline(proof, judgement, verdict)}
    low, high = verdict.latitude
    assert figures["dose latitude"] == f"{100 * (low - 1):+.2g} % … {100 * (high - 1):+.2g} %".replace("-", "−")
    pixel, found = judgement.pixel, judgement.over_tolerance
    assert figures[f"window a pixel from the surface, {1e3 * pixel:.3g} µm"] == summary.signed(found.at(pixel))
    assert figures["of the threshold, beyond the cylinder"] == f"{proof.outer_share:.2f}"
    assert figures["distance from the part's surface, RMS"] == f"{1e3 * judgement.surface.rms:.3g} µm"
    times = proof.exposure
    assert times is not None and figures["exposure"] == f"{times.seconds:.3g} s"
    headline = page[page.index('class="headline"') : page.index('class="summary"')]
    assert all(value in headline for value in figures.values()) and f"{times.seconds / 9:.3g} turns" in headline


def test_the_tolerance_table_shows_every_row(proof: Proof, judgement: Any) -> None:
    groups = summary.table(judgement.table)
    assert [group["name"] for group in groups] == ["Nominal", *summary.WORDS.values()]
    assert groups[0]["rows"][0]["window"] == summary.signed(judgement.table.nominal.window)
    cells = [row for group in groups[1:] for row in group["rows"]]
    assert [(c["change"], c["wrong"]) for c in cells] == [(r.change, f"{r.wrong:,}") for r in judgement.table.rows]
    page = report.page_of(proof, None, judgement).html()
    for group in groups[1:]:
        assert group["name"] in page and group["first"] in page and group["first"]
    assert f"{judgement.table.exposures} back projections" in page


@pytest.mark.slow
def test_the_page_says_what_was_not_judged(proof: Proof, judgement: Any) -> None:
    page = report.page_of(proof, None, replace(judgement, not_judged=("other exposures",)))
    assert "Not judged: other exposures." in page.html()


def test_the_fine_dose_is_judged_where_there_is_one(proof: Proof, judgement: Any) -> None:
    """W(0) on finer voxels sees what the mean over a voxel hides; without rays the own voxels are all there is."""
    own = replace(proof, independent=False)
    its_own = judged(own)
    fine, coarse = judgement.over_tolerance, its_own.over_tolerance
    assert coarse.at(0.0) == pytest.approx(proof.scores.window, abs=1e-5)
    assert fine.at(0.0) < coarse.at(0.0)
    page = report.page_of(own, None, its_own).html()
    assert "according to the solver's own dose" in html.unescape(page) and 'class="verdict bad"' in page


def test_every_number_of_the_light_says_what_it_is(proof: Proof, page: str) -> None:
    dose, target, disc = proof.dose.numpy(), proof.target.numpy() >= 0.5, GRID.cylinder()[:, :, None]
    wanted = dose[~target & disc].mean() / dose[target & disc].mean()
    assert proof.outside_over_inside == pytest.approx(wanted, rel=1e-5)
    light = {line.name: line for line in proof.lines()}
    names = ("light efficiency", "idle light", "mean brightness", "dose outside over inside")
    assert all(len(light[name].meaning) > 30 for name in names)
    tiles = page[page.index('class="tiles"') : page.index("<main>")]
    for name in names:
        assert re.search(rf"<span>{name}</span><small>[^<]+</small>", tiles)


def test_resin_that_prints_beyond_the_cylinder_is_told(proof: Proof, judgement: Any) -> None:
    assert proof.outer is not None
    flooded = replace(proof, outer=replace(proof.outer, dose=1.2 * proof.scores.threshold))
    page = report.page_of(flooded, None, judgement).html()
    assert "resin beyond the judged cylinder also prints (" in page and "1.20 of the threshold" in page
    assert "Orange: resin beyond" in page and 'class="verdict bad"' in page
    assert 'class="remedy">→ move the part away from the wall' in page


@pytest.mark.slow
def test_the_mesh_is_joined_and_searched_once_for_a_report(proof: Proof, monkeypatch: pytest.MonkeyPatch) -> None:
    import trimesh

    from vamgpu.metrics import surface_judgement
    from vamgpu.printing import proof as of_proof

    calls: list[str] = []
    for module in (of_proof, surface_judgement):
        for name in ("joined", "unjudged"):
            plain = getattr(module, name)
            counted = lambda *given, plain=plain, name=name: (calls.append(name), plain(*given))[1]  # noqa: E731
            monkeypatch.setattr(module, name, counted)
    mesh: Any = trimesh.creation.icosphere(3, 1.4)
    known = replace(proof, solid=Solid(np.asarray(mesh.vertices), np.asarray(mesh.faces), "ball"))
    found = judged(known)
    assert found.surface.unjudged is known.unjudged and not known.all_correct
    assert sorted(calls) == ["joined", "unjudged"]


def test_a_report_without_a_plan_has_no_convergence(unplanned: Any) -> None:
    assert "Convergence" not in unplanned.html()


def test_a_report_that_cannot_be_written_says_so_and_leaves_nothing(
    proof: Proof, unplanned: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(report, "page_of", lambda *_: unplanned)
    with pytest.raises(StorageError, match="choose another path"):
        proof.report(tmp_path / "missing" / "proof.html")
    (tmp_path / "taken.html").mkdir()
    with pytest.raises(StorageError, match="taken.html"):
        proof.report(tmp_path / "taken.html")
    assert [entry.name for entry in tmp_path.iterdir()] == ["taken.html"]


def test_the_slice_sheet_holds_dose_target_and_verdict(proof: Proof, page: str) -> None:
    sheet = data_of(page)["sheet"]
    image = np.asarray(Image.open(BytesIO(base64.b64decode(sheet["image"].split(",")[1]))))
    dose, target, printed = proof.dose.numpy(), proof.target.numpy(), proof.printed()
    for index, z in enumerate(sheet["slices"]):
        row, column = divmod(index, sheet["across"])
        tile = image[row * 24 : (row + 1) * 24, column * 24 : (column + 1) * 24].astype(int)
        x, y = 9, 15
        pixel = tile[23 - y, x]
        assert pixel[0] == round(255 * min(1, dose[x, y, z] / proof.scores.peak))
        assert pixel[1] == round(255 * target[x, y, z])
        wanted = target[x, y, z] >= 0.5
        verdict = {(True, True): 1, (True, False): 2, (False, True): 3, (False, False): 0}
        assert pixel[2] == 40 * verdict[bool(wanted), bool(printed[x, y, z])]
        assert tile[0, 0, 2] == 40 * pictures.OUTSIDE


def test_verdicts_add_up_to_the_scores(proof: Proof) -> None:
    printed, target = proof.printed(), proof.target.numpy()
    verdict = pictures.verdicts(target, printed, GRID.cylinder())
    assert (verdict == pictures.MISSING).sum() == proof.scores.missing
    assert (verdict == pictures.EXCESS).sum() == proof.scores.excess


def test_every_kind_of_voxel_has_its_verdict() -> None:
    target, printed = np.array([[[0.0, 0.0, 0.5, 1.0]]]), np.array([[[False, True, False, True]]])
    found = pictures.verdicts(target, printed, np.ones((1, 1), bool))
    assert found.tolist() == [[[0, pictures.EXCESS, pictures.MISSING, pictures.HIT]]]


def test_blocks_and_slabs_of_a_field() -> None:
    """Voxels missing in the last blocks count as zero; slabs along z follow each other."""
    field = np.random.default_rng(0).random((37, 5, 7)).astype(np.float32)
    padded = np.pad(field, ((0, 2), (0, 1), (0, 2))).reshape(13, 3, 2, 3, 3, 3)
    assert surface.block_mean(field, 3) == pytest.approx(padded.mean(axis=(1, 3, 5)), rel=1e-6)
    assert np.array_equal(_joined([field[:, :, :2], field[:, :, 2:6], field[:, :, 6:]]), field)


def test_surfaces_enclose_the_volume_and_face_outwards() -> None:
    x, y, z = np.meshgrid(*(np.arange(n) - (n - 1) / 2 for n in (40, 44, 48)), indexing="ij")
    inwards = -np.sqrt(x**2 + y**2 + (z - 2) ** 2)
    ball, grown = (surface.iso_surface(np.clip(inwards + r + 0.5, 0, 1), 0.5, 0.1) for r in (15.0, 16.0))
    a, b, c = (ball.points[ball.faces[:, k]] for k in range(3))
    assert np.einsum("ij,ij->", np.cross(b - a, c - a), a) / 6 == pytest.approx(4 / 3 * np.pi * 1.5**3, rel=0.01)
    assert ball.points.mean(axis=0) == pytest.approx([0, 0, 0.2], abs=0.01)
    outwards = ball.points - [0, 0, 0.2]
    assert (np.einsum("ij,ij->i", ball.normals, outwards) > 0).all()
    found = surface.deviation(grown, ball)
    assert found == pytest.approx(0.1, abs=0.02)
    assert surface.iso_surface(np.zeros((5, 5, 1)), 0.5, 0.1) is surface.NOTHING


def test_stray_resin_is_pooled_where_it_is() -> None:
    """Cells of slabs, which overlap no cell twice, against a loop over voxels; the ball marks the greatest dose."""
    rng, pitch = np.random.default_rng(3), 0.05
    x = (np.arange(200) - 99.5) * pitch
    slabs, cells = [], set()
    width = 2 * pitch
    for z in (np.arange(-8, 1) * pitch, np.arange(1, 6) * pitch):
        dose = (rng.random((200, 200, z.size)) < 1e-3).astype(np.float32)
        slabs.append(SimpleNamespace(dose=SimpleNamespace(numpy=lambda dose=dose: dose), x=x, y=x, z=z, pitch=pitch,
                                     radius=4.5))  # fmt: skip
        for i, j, k in np.argwhere(dose > 0.5):
            if 3.0 < np.hypot(x[i], x[j]) <= 4.5:
                cells.add(tuple(np.rint((np.array((x[i], x[j], z[k])) - x[0]) / width).astype(int).tolist()))
    proof: Any = SimpleNamespace(
        outer=SimpleNamespace(place=(0.0, 0.0, 9.0), width=0.1), outer_share=1.0, independent=True, solid_from=0.5,
        fine=lambda: slabs, operator=SimpleNamespace(grid=SimpleNamespace(inscribed_radius=3.0)),
    )  # fmt: skip
    found = surface.stray(proof)
    low, high = (np.asarray(end(list(cells), axis=0)) for end in (np.min, np.max))
    points = found.points[found.points[:, 2] < 5.0]
    np.testing.assert_allclose(points.min(axis=0), (low - 0.5) * width + x[0], atol=1e-6)
    np.testing.assert_allclose(points.max(axis=0), (high + 0.5) * width + x[0], atol=1e-6)
    at = (points - x[0]) / width
    near = np.unique(np.concatenate([np.floor(at), np.ceil(at)]).astype(int), axis=0)
    assert cells <= set(map(tuple, near.tolist())), "each cell has surface about it"
    assert len(points) <= 6 * len(cells) and found.points[:, 2].max() == pytest.approx(9.2)


def test_a_packed_surface_unpacks_to_itself() -> None:
    solid = surface.iso_surface(ball((20, 20, 20)), 0.5, 0.1)
    texts = solid.packed(np.zeros(len(solid.points)), 2.0)
    packed = {name: zlib.decompress(base64.b64decode(text)) for name, text in texts.items()}
    points = np.cumsum(np.frombuffer(packed["points"], "<i2").reshape(-1, 3), axis=0, dtype=np.int16) / 32767 * 2.0
    assert np.abs(points - solid.points).max() < 1e-4
    assert np.array_equal(np.cumsum(np.frombuffer(packed["faces"], "<i4")), solid.faces.ravel())


def test_a_long_field_is_averaged_in_blocks() -> None:
    field = np.zeros((300, 6, 6))
    field[90:210, 1:5, 1:5] = 1.0
    solid = surface.iso_surface(field, 0.4, 0.1)
    assert solid.points[:, 0].min() == pytest.approx(-6.0, abs=0.2)
    assert solid.points[:, 0].max() == pytest.approx(6.0, abs=0.2)


def test_history_columns_read_dataclasses_and_dictionaries() -> None:
    found = charts.columns([Record(1, 0.5, None), {"projector_pairs": 2, "loss": np.float32(0.25), "note": "x"}])
    assert found["projector_pairs"].tolist() == [1, 2] and found["loss"].tolist() == [0.5, 0.25]
    assert "note" not in found and "window" not in found
    assert charts.convergence_chart([Record(1, 0.5, 0.1)]) is None


def test_pictures_are_paid_for_only_when_drawn() -> None:
    code = (
        "import sys, vamgpu.printing.report, vamgpu.printing.simulate; "
        "print([m for m in ('matplotlib', 'skimage', 'scipy', 'PIL', 'jinja2') if m in sys.modules])"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"


@pytest.mark.slow
def test_a_print_of_a_single_slice_without_a_vessel(tmp_path: Path) -> None:
    A = Projection(Grid((20, 20, 1), 0.2), Beam((20, 1), 0.2), Turntable(8), device="numpy")
    target = ball((20, 20, 3))[:, :, 1:2]
    found = simulate(A, Shown(np.asarray(A(target))), target)
    page = found.report(tmp_path / "slice.html").read_text(encoding="utf-8")
    assert "straight light" in page and "until resin at the threshold is solid" not in page


@pytest.mark.slow
@pytest.mark.parametrize(("switch", "painted"), [("--disable-3d-apis", True), ("--use-angle=swiftshader", False)])
def test_without_webgl_the_part_is_painted_and_the_page_says_what_to_do(switch: str, painted: bool, path: Path) -> None:
    sync_api = optional("playwright.sync_api", 'the page is opened in a browser: pip install "vamgpu[all]"')
    with sync_api.sync_playwright() as tools:
        arguments = ["--no-sandbox", "--enable-unsafe-swiftshader", switch]
        opened = tools.chromium.launch(executable_path=browser(), args=arguments, timeout=WAIT).new_page()
        opened.goto(path.as_uri())
        drawn = "document.getElementById('solid').toDataURL().length > 8000"  # a picture, not one plain color
        opened.wait_for_function(drawn, timeout=4 * WAIT)
        assert opened.locator("#painted").is_visible() == painted
        if painted:
            assert "hardware acceleration" in opened.locator("#painted").inner_text()

"""Scattering found from cuvettes, judged by photons of another program."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cuvettes import ACCEPTANCE, BEAM, GLASS, HOLE, PIXEL, PORT, RESIN, SCREEN, WALL, WIDTH, Liquid, measured, through
from PIL import Image

import vamgpu as vam
from vamgpu.cli import main
from vamgpu.errors import BadInput, JobError
from vamgpu.jobs.cuvettes import CuvetteJob
from vamgpu.jobs.read import Job
from vamgpu.optics.cuvette import Cuvette, detected, ring_edges
from vamgpu.optics.scattering_fit import CuvetteSample, fit_scattering

CUVETTE = Cuvette(width=WIDTH, wall=WALL, resin_index=RESIN, wall_index=GLASS, beam=BEAM, screen=SCREEN, pixel=PIXEL,
                  hole=HOLE, acceptance=ACCEPTANCE, port=PORT, dark=100.0)  # fmt: skip
LIQUID = Liquid(0.6, 0.85, 0.05)


def samples(liquid: Liquid, photons: int, seed: int, depths: tuple[float, ...] = (0.4, 1.0, 2.2)) -> list[Any]:
    """Cuvettes of the given optical depths, at most 8 mm thick."""
    rng, rate = np.random.default_rng(seed), liquid.scattering + liquid.absorption
    lengths = [round(min(depth / rate, 8.0), 1) for depth in depths]
    return [CuvetteSample(length, **measured(length, liquid, photons, rng)) for length in lengths]


@pytest.fixture(scope="module")
def read() -> list[Any]:
    return samples(LIQUID, 60_000, 1)


def test_a_resin_is_found_within_its_interval(read: list[Any]) -> None:
    found = fit_scattering(CUVETTE, read, photons=30_000)
    given = np.array([found.scattering.coefficient, float(found.scattering.anisotropy), found.absorption])
    away = given - [LIQUID.scattering, LIQUID.g, LIQUID.absorption]
    assert abs(away[0]) < 0.05 * LIQUID.scattering and abs(away[1]) < 0.02
    assert (np.abs(away) < 2.5 * np.array(found.errors)).all()
    assert 0.6 < found.misfit < 1.4
    assert found.errors[0] < 0.05 * LIQUID.scattering and found.errors[1] < 0.02


@pytest.mark.slow
def test_ten_resins_are_found() -> None:
    """Within 10 % and 0.02, and 95 % of the values within the intervals."""
    covered, rng = [], np.random.default_rng(5)
    for seed in range(10):
        liquid = Liquid(rng.uniform(0.2, 1.5), rng.uniform(0.4, 0.96), rng.uniform(0.01, 0.15))
        found = fit_scattering(CUVETTE, samples(liquid, 250_000, seed), photons=120_000)
        given = np.array([found.scattering.coefficient, float(found.scattering.anisotropy), found.absorption])
        away = given - [liquid.scattering, liquid.g, liquid.absorption]
        assert abs(away[0]) < 0.1 * liquid.scattering and abs(away[1]) < 0.02, (liquid, found)
        assert (np.abs(away) < 4.0 * np.array(found.errors)).all(), (liquid, found)
        covered += list(np.abs(away) < 2.0 * np.array(found.errors))
    assert sum(covered) >= 26, "of 30, of which 28.6 are expected"


def test_derivatives_are_those_of_the_light() -> None:
    """The slopes of all photons against differences of runs with the same random numbers."""
    edges = ring_edges(CUVETTE, 28.0, 6)

    def light(scattering: float, g: float, absorption: float) -> Any:
        return detected(CUVETTE, 2.0, vam.Scattering(scattering, g), absorption, edges, 120_000, 3)

    slope, steps = light(0.6, 0.7, 0.05)[1], np.diag([0.06, 0.03, 0.01])
    for each, step in zip(slope, steps, strict=True):
        ahead, behind = (light(*(np.array([0.6, 0.7, 0.05]) + side * step)) for side in (0.5, -0.5))
        difference, noise = (ahead[0] - behind[0]) / step.max(), np.sqrt(ahead[2]) / step.max()
        assert (np.abs(difference - each) < 0.02 * np.abs(difference) + 3.0 * noise).all()


def test_a_resin_that_hardly_scatters_follows_beer_and_fresnel() -> None:
    """Collimated light is exp(−(μ_s + absorption) · length) between faces that reflect, in closed form."""
    found, *_ = detected(CUVETTE, 3.0, vam.Scattering(1e-9, 0.5), 0.2, np.array([5.0, 9.0]), 1000, 0)
    air = 1.0 - ((GLASS - 1.0) / (GLASS + 1.0)) ** 2
    face = air * (1.0 - ((GLASS - RESIN) / (GLASS + RESIN)) ** 2)
    once = np.exp(-0.6)
    assert found[:2] == pytest.approx(face**2 * once / (1.0 - ((1.0 - face) * once) ** 2), rel=1e-6)
    assert found[2] < 1e-8


def test_the_slope_of_the_clear_beam_counts_its_reflections(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("vamgpu.optics.cuvette.MOST", 3)  # next to no light is scattered
    (ahead, *_), (_, slope, *_), (behind, *_) = (
        detected(CUVETTE, 1.0, vam.Scattering(1e-9, 0.5), rate, np.array([5.0, 9.0]), 1000, 0)
        for rate in (0.101, 0.1, 0.099)
    )
    assert slope[2, :2] == pytest.approx((ahead - behind)[:2] / 0.002, rel=1e-5)


def test_the_meter_of_collimated_light_collects_what_is_hardly_turned() -> None:
    """Of light that is scattered once, the share within an angle is an integral of the phase function."""
    meter, g = replace(CUVETTE, acceptance=0.17), 0.7
    resin = vam.Scattering(0.005, g)
    (collimated, *_), *_ = detected(meter, 2.0, resin, 0.0, np.array([5.0, 9.0]), 100_000, 0)
    (clear, *_), *_ = detected(CUVETTE, 2.0, resin, 0.0, np.array([5.0, 9.0]), 1000, 0)
    cosine = np.sqrt(1.0 - (np.sin(0.17) / RESIN) ** 2)
    share = (1.0 - g * g) / (2.0 * g) * (1.0 / (1.0 - g) - 1.0 / np.sqrt(1.0 + g * g - 2.0 * g * cosine))
    assert collimated - clear == pytest.approx(0.01 * share * CUVETTE.clear**2, rel=0.05)


def test_light_that_the_inner_face_of_a_wall_reflects_stays_where_it_is() -> None:
    """Beyond the critical angle of resin in walls of less index; a shift there lost 7 % of the light."""
    rng, photons = np.random.default_rng(0), 60_000
    place, _ = through(2.0, Liquid(2.0, 0.05, 0.02), photons, rng, np.array([1.0, 1.46, 1.5, 1.46, 1.0]))
    cuvette, edges = replace(CUVETTE, resin_index=1.5, wall_index=1.46), np.array([5.0, 9.0])
    light, *_ = detected(cuvette, 2.0, vam.Scattering(2.0, 0.05), 0.02, edges, 30_000, 0)
    assert light[1] == pytest.approx((np.hypot(*place.T[:2]) < 0.5 * PORT).sum() / photons, rel=0.04)


def test_the_variance_is_that_of_runs_with_other_photons() -> None:
    """Ways of one photon are not independent: taken as such, total light spreads less than it does."""
    edges, resin = ring_edges(CUVETTE, 28.0, 3), vam.Scattering(2.0, 0.5)
    runs = [detected(CUVETTE, 4.0, resin, 0.02, edges, 1000, seed) for seed in range(60)]
    ratio = np.var([light for light, *_ in runs], axis=0, ddof=1) / np.mean([run[2] for run in runs], axis=0)
    assert (np.abs(ratio[1:] - 1.0) < 0.6).all(), ratio


def test_a_ring_without_photons_names_a_number_that_is_enough() -> None:
    sharp = samples(Liquid(0.05, 0.975, 0.02), 200_000, 1)
    with pytest.raises(BadInput, match="none of 1_000 photons reached") as caught:
        fit_scattering(CUVETTE, sharp, photons=1000)
    enough = re.search(r"photons=([\d_]+)", str(caught.value))
    assert enough is not None and fit_scattering(CUVETTE, sharp, photons=int(enough[1])).misfit < 1.5


def test_photons_that_are_given_up_are_counted(read: list[Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """What leaves and what is given up are the light that is scattered, if nothing is absorbed or leaves the sides."""
    wide, edges = replace(CUVETTE, width=1e4, port=None), ring_edges(CUVETTE, 28.0, 3)
    every, *_, none = detected(wide, 2.0, vam.Scattering(2.0, 0.5), 0.0, edges, 4000, 0)
    assert none == 0.0
    monkeypatch.setattr("vamgpu.optics.cuvette.MOST", 12)
    some, *_, left = detected(wide, 2.0, vam.Scattering(2.0, 0.5), 0.0, edges, 4000, 0)
    assert 0.3 < (every[1] - some[1]) / left < 0.7, "about half of it would leave the far face"
    with pytest.raises(BadInput, match="of the beam was given up in the cuvette of .* mm"):
        fit_scattering(CUVETTE, read, photons=8000)


def changed(read: list[Any], sample: int, **given: Any) -> list[Any]:
    return [replace(each, **given) if k == sample else each for k, each in enumerate(read)]


def test_impossible_readings_are_refused(read: list[Any]) -> None:
    image, low = read[0].image, int(np.quantile(read[2].image, 0.99))
    wrong: dict[str, tuple[list[Any], Cuvette]] = {
        "mm alone; expected two": (read[:1], CUVETTE),
        "no sample has an image": ([replace(each, image=None) for each in read], CUVETTE),
        "the near face passes": (changed(read, 0, total=0.99), CUVETTE),
        "collimated light is .*expected it to fall": (changed(read, 1, collimated=0.8, total=0.85), CUVETTE),
        "got no sample; expected two": ([], CUVETTE),
        "total light is .*expected it to fall": (changed(read, 2, total=read[0].total), CUVETTE),
        "saturated outside the hole": (read, replace(CUVETTE, full=float(np.quantile(image, 0.95)))),
        f"saturated outside the hole; expected gray levels below {low}": (
            changed(read, 2, image=np.minimum(read[2].image, low)),
            CUVETTE,
        ),
        "holds float32; expected whole numbers, or full": (changed(read, 1, image=np.float32(image)), CUVETTE),
        "is dark": (changed(read, 0, image=np.full_like(image, 100)), CUVETTE),
        "shows the paper": (changed(read, 0, image=image[:60]), CUVETTE),
        "standard deviations from what other": (changed(read, 2, total=0.99 * read[0].total), CUVETTE),
    }
    for message, (given, cuvette) in wrong.items():
        with pytest.raises(BadInput, match=message):
            fit_scattering(cuvette, given, photons=8000)
    for given, message in (({"total": 0.1}, "exchange the two"), ({"collimated": -0.1}, "CuvetteSample collimated"),
                           ({"image": np.zeros(3)}, "gray levels")):  # fmt: skip
        with pytest.raises(BadInput, match=message):
            replace(read[0], **given)
    clear = [replace(each, total=total) for each, total in zip(read[:2], (0.89, 0.88), strict=True)]
    least = fit_scattering(replace(CUVETTE, error=0.1), clear, photons=8000)
    assert "# absorption was not measured" in least.toml() and np.isinf(least.errors[2])
    with pytest.raises(BadInput, match="photons is 10; expected at least 1000"):
        fit_scattering(CUVETTE, read, photons=10)
    with pytest.raises(BadInput, match="less than the cuvette of 10"):
        replace(CUVETTE, beam=12.0)
    with pytest.raises(BadInput, match="full is 0; expected more than dark"):
        replace(CUVETTE, full=0.0)


TEXT = """
[cuvette]
width = "10 mm"
wall = "1.25 mm"
resin_index = 1.48
wall_index = 1.52
beam = "1 mm"
acceptance = "0.0087 rad"
port = "8 mm"
screen = "25 mm"
pixel = "0.25 mm"
hole = "6 mm"
dark = 100.0
"""


def test_the_command_writes_tables_for_a_job(
    read: list[Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = TEXT
    for k, each in enumerate(read):
        text += f'[[sample]]\nthickness = "{each.thickness} mm"\ncollimated = {each.collimated}\ntotal = {each.total}\n'
        text += f'image = "{k}.png"\n' if k else ""
        Image.fromarray(each.image).save(tmp_path / f"{k}.png")
    (tmp_path / "cuvettes.toml").write_text(text, encoding="utf-8")
    job, out = CuvetteJob.read(tmp_path / "cuvettes.toml"), tmp_path / "scattering.toml"
    assert job.file.cuvette == CUVETTE
    assert main(["calibrate", "scatter", str(tmp_path / "cuvettes.toml"), "--out", str(out), "--photons", "16000"]) == 0
    found, said = job.fitted(16_000), capsys.readouterr().out
    assert found.lines()[0][1] in said and "95 %" in said
    rest = '[target]\nshape = "boat"\nheight = "5 mm"\n[beam]\npitch = "67 um"\n'
    vial = 'radius = "8 mm"\nwall = "1 mm"\nresin_index = 1.48\nwall_index = 1.47\n'
    file = Job.parse(rest + out.read_text(encoding="utf-8") + vial).file
    assert file.scattering is not None and file.vial is not None
    assert file.scattering().coefficient == pytest.approx(found.scattering.coefficient, rel=1e-3)
    assert file.vial.absorption == pytest.approx(found.absorption, rel=1e-3)
    (tmp_path / "1.png").write_bytes(b"no image")
    with pytest.raises(JobError, match=r"sample.image: cannot read '1.png'"):
        job.fitted()

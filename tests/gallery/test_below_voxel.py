"""The record of prints below the voxel: its judge against formulas and against the operator, and its picture."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

import vamgpu
from profiling import below_voxel
from profiling.below_voxel import Judge, Posed, bracket, part, posed
from profiling.gallery import draw
from vamgpu.backend import open_device
from vamgpu.geometry import Turntable
from vamgpu.targets.shapes import csg
from vamgpu.targets.solid import Solid

pytestmark = pytest.mark.filterwarnings("ignore::vamgpu.errors.SamplingWarning")
SIDE, HIGH = 4.0, 3.0


def box() -> Solid:
    return csg.to_solid(csg.box((0.0, 0.0, 0.0), (SIDE, SIDE, HIGH)), "box")


@cache
def job(lit_share: float = 1.0) -> Posed:
    return posed(box(), 9.0, open_device("numpy"), angles=24, lit_share=lit_share)


@cache
def judge() -> Judge:
    return Judge.of(job())


def smooth(shape: tuple[int, ...]) -> np.ndarray:
    """Light that varies over angles, columns and rows, and knows left from right."""
    theta, r, z = (np.linspace(0.0, 1.0, n) for n in shape)
    turn = 1.0 + 0.5 * np.cos(2.0 * np.pi * theta)[:, None, None]
    return (turn * (0.3 + r**2)[:, None] * (0.5 + z)).astype(np.float32)


@pytest.mark.parametrize("lit_share", [1.0, 0.0])
def test_the_judge_exposes_what_the_operator_does(lit_share: float) -> None:
    A, looked = job(lit_share).A, judge()
    light = smooth(A.range.shape)
    exposed = A.T(A.device.upload(light)).numpy() * A.beam.pixel_area / A.grid.voxel_volume
    (x, z), (gx, _, gz) = looked.axes, A.grid.axes()
    between = RegularGridInterpolator((x, x, z), looked.dose(light, A.motion))
    points = np.stack(np.meshgrid(gx, gx, gz, indexing="ij"), axis=-1)
    inside = np.hypot(gx[:, None], gx[None, :]) < 0.8 * looked.radius
    have, want = between(points[inside][:, 2:-2]), exposed[inside][:, 2:-2]
    np.testing.assert_allclose(have, want, rtol=3e-3)


def test_motion_blurs_a_bright_column() -> None:
    looked, light = judge(), np.zeros(job().A.range.shape, np.float32)
    light[0, light.shape[1] // 2 + 6] = 1.0
    blurred, sharp = (looked.dose(light, Turntable(24, lit_share=share)) for share in (1.0, 0.0))
    assert blurred.sum() == pytest.approx(sharp.sum(), rel=0.02)
    assert blurred.max() < 0.95 * sharp.max()


def test_depths_are_those_of_a_box() -> None:
    looked = judge()
    x, z = looked.axes
    gaps = np.meshgrid(np.abs(x) - 0.5 * SIDE, np.abs(x) - 0.5 * SIDE, np.abs(z) - 0.5 * HIGH, indexing="ij")
    outside = np.sqrt(sum(np.maximum(gap, 0.0) ** 2 for gap in gaps))
    want = -(outside + np.minimum(np.max(gaps, axis=0), 0.0)) / looked.pixel
    known = np.abs(want) < 2.5
    off = np.abs(looked.depth - want)[known]
    # a corner fills a voxel by an eighth where a plane through its middle fills half
    assert np.sqrt(np.mean(off**2)) < 0.04 and off.max() < 0.3


def test_a_dose_that_falls_evenly_across_the_surface_is_judged_by_its_slope(monkeypatch: pytest.MonkeyPatch) -> None:
    looked, slope = judge(), 0.1
    dose = (1.0 + slope * looked.depth / below_voxel.REACH).astype(np.float32)
    monkeypatch.setattr(Judge, "dose", lambda self, light, motion: dose)
    numbers, over = looked.judge(smooth(job().A.range.shape), job().A.motion)
    for away in below_voxel.DEPTHS:
        assert numbers[f"W{away:g}"] == pytest.approx(2.0 * slope * away / below_voxel.REACH / dose.max(), rel=0.4)
    assert (numbers["bodies"], numbers["voids"]) == (1, 1)
    assert numbers["deepest"] < 0.3 and numbers["rms"] < 60.0 * looked.pixel
    assert over.max() > 1.0 > over[looked.cylinder].min()


def test_the_bracket_is_one_closed_body_with_a_bore_and_letters() -> None:
    whole, flat = bracket(), bracket(text=0.01)
    assert whole.open_edges == flat.open_edges == 0
    assert 0.5 * 3.0 < whole.volume - flat.volume < 12.0
    edges = {tuple(sorted(pair)) for a, b, c in whole.faces.tolist() for pair in ((a, b), (b, c), (c, a))}
    euler = len(np.unique(whole.faces)) - len(edges) + len(whole.faces)
    assert euler == 0  # one bore; the A's hole is a dent of the plate's top


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.slow] * (n == "gyroid_sphere")) for n in below_voxel.SHAPES]
)
def test_every_part_is_centered_and_closes(name: str) -> None:
    solid = part(name)
    assert solid.open_edges == 0 and solid.radius < vamgpu.Vial(**below_voxel.VIAL).lit_radius


def test_a_record_tells_every_method_of_every_part(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    asked = "--parts nut --methods ramp lbfgs --budgets 4 --size 7 --angles 24 --quick --label test --records"
    below_voxel.main([*asked.split(), str(tmp_path)])
    record = json.loads((tmp_path / "below-voxel-test.json").read_text("utf-8"))
    assert set(record["parts"]["nut"]["methods"]) == {"ramp", "lbfgs"}
    rows = [line for line in capsys.readouterr().out.splitlines() if line.startswith("| nut |")]
    assert len(rows) == 2 and all(row.count("|") == len(below_voxel.HEADER) + 1 for row in rows)
    assert below_voxel.apart(record) == 0.0


def test_the_kept_record_has_the_default_ahead() -> None:
    path = Path(below_voxel.__file__).parent / "records" / "below-voxel-cpu.json"
    record = json.loads(path.read_text("utf-8"))
    last, behind = str(record["budgets"][-1]), set[str]()
    for name, part_ in record["parts"].items():
        judged = {method: each[last]["judged"] for method, each in part_["methods"].items()}
        if judged["ramp"]["rms"] > min(each["rms"] for each in judged.values()):
            behind.add(name)
        if judged["ramp"]["W1"] is not None:  # parts less than two pixels thick have none
            assert judged["ramp"]["W1"] == max(each["W1"] for each in judged.values())
    assert behind == {"gyroid_sphere"}, "the page says that L-BFGS has the better surface there, and nowhere else"
    assert below_voxel.table(record).count("\n") > len(record["parts"])
    page = Path(__file__).parents[2] / "docs" / "best-light.md"
    assert below_voxel.overview(record) in page.read_text("utf-8"), "the page has another table than the record"


@pytest.mark.slow
def test_coarse_voxels_claim_what_they_do_not_print() -> None:
    numbers = draw("below", quick=True).numbers()
    coarse, default = "a, L-BFGS, voxels of 2 pixels", "d, default"
    assert numbers[f"{coarse}, claimed"] > numbers[f"{coarse}, W ½ pixel"] + 0.1
    for key in ("W ½ pixel", "W 1 pixel"):
        assert numbers[f"{default}, {key}"] > numbers[f"{coarse}, {key}"]

"""A medium from arrays against rays and absorption in closed form."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import vamgpu as vam
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, JobError, StorageError
from vamgpu.jobs.build import projection_of, target_of
from vamgpu.jobs.read import Job
from vamgpu.jobs.run import prove, solve
from vamgpu.operators.traced_projection import TracedProjection
from vamgpu.optics.index_field import fish_eye

INDEX, RADIUS = 1.48, 2.0
GRID = vam.Grid((64, 64, 1), 0.08)
SAMPLES, PITCH = 81, 0.06


def places(samples: int = SAMPLES, pitch: float = PITCH) -> tuple[np.ndarray, np.ndarray]:
    along = (np.arange(samples) - 0.5 * (samples - 1)) * pitch
    return np.meshgrid(along, along, indexing="ij")


def test_voxels_get_the_mean_of_their_samples() -> None:
    """Of a linear field anywhere inside, at any pitch and position; beyond the samples they get the resin."""
    center, grid = (0.25, -0.1, 0.3), vam.Grid((16, 12, 8), 0.1)
    for pitch in (0.025, 0.2):
        count = 2 * int(0.8 / pitch) + 1
        x, y, z = (c + (np.arange(count) - 0.5 * (count - 1)) * pitch for c in center)
        field = 1.5 + 0.02 * x[:, None, None] - 0.03 * y[:, None] + 0.01 * z
        found = vam.SampledMedium(pitch, index=field, center=center)._on(grid, 1.4).index
        assert found is not None
        gx, gy, gz = grid.axes()
        expected = 1.5 + 0.02 * gx[:, None, None] - 0.03 * gy[:, None] + 0.01 * gz
        inside = np.ix_(*(np.abs(g - c) < 0.8 - 0.05 for g, c in zip((gx, gy, gz), center, strict=True)))
        assert found[inside] == pytest.approx(expected[inside], abs=1e-6)
        assert (found[0] == 1.4).all() == (pitch < 0.1)
        assert found.min() >= 1.4 - 1e-9
    for pitch in (0.03, 0.07, 0.17):
        x = (np.arange(21) - 10) * pitch
        bumps = np.cos(9.0 * x)[:, None] + 0.0 * x
        found = vam.SampledMedium(pitch, absorption=1.0 + bumps)._on(vam.Grid((4, 4, 1), 0.1), 1.5).extinction
        fine = vam.Grid((4, 1, 1), 0.1).axes()[0][:, None] + (np.arange(4000) - 1999.5) * 0.1 / 4000
        assert np.asarray(found)[:, 1][1:3] == pytest.approx(1.0 + np.interp(fine, x, bumps[:, 0]).mean(axis=1)[1:3])
    gone = vam.SampledMedium(0.1, absorption=np.full((4, 4), 0.7))._on(vam.Grid((32, 32, 2), 0.1), 1.5, 0.2)
    assert gone.index is None and isinstance(gone.extinction, np.ndarray)
    assert gone.extinction[15:17, 15:17] == pytest.approx(0.7) and gone.extinction[4, 15] == pytest.approx(0.2)
    assert gone.extinction[0, 0] == 0.0, "beyond the circle of the grid"
    clear = vam.SampledMedium(0.03, absorption=np.zeros((101, 101), np.float32))._on(vam.Grid((8, 8, 1), 0.1), 1.5, 0.1)
    assert clear.extinction is None or np.min(clear.extinction) >= 0.0, "whatever shares are rounded to"


def test_rays_in_a_graded_cylinder_end_where_its_formula_says(fast_device: Device) -> None:
    """In n² ∝ 1 − s²r², d²r/dt² = ½∇n² is an oscillator: rays are ellipses."""
    slope, (x, y) = 0.25, places()
    square = 1.0 - (slope * np.minimum(np.hypot(x, y), RADIUS)) ** 2
    medium = vam.SampledMedium(PITCH, index=INDEX * np.sqrt(square / (1.0 - (slope * RADIUS) ** 2)))
    beam, motion = vam.Beam((49, 1), 0.08), vam.Turntable(1, lit_share=0.0)
    vial = vam.Vial(3.0, 0.2, INDEX, INDEX, INDEX)
    A = medium.operator(GRID, beam, motion, vial, rays=1, device=fast_device)
    assert isinstance(A, TracedProjection)
    for column, offset in ((36, 12), (44, 20), (28, 4)):
        light = np.zeros((1, 49, 1), np.float32)
        light[0, column, 0] = 1.0
        dose = A.T(light)[:, :, 0]
        u = beam.columns()[column]
        assert u == pytest.approx(offset * 0.08)
        gx, gy, _ = GRID.axes()
        rows = [int(np.argmin(np.abs(gx + depth))) for depth in (0.0, 1.0)]  # behind the axis, inside the cylinder
        found = [float((dose[k] * gy).sum() / dose[k].sum()) for k in rows]
        assert found == pytest.approx([bent(u, -gx[k], slope) for k in rows], abs=0.25 * 0.08)
        assert abs(found[1] - u) > 0.05 * abs(u), "bent by more than the tolerance"


def bent(u: float, depth: float, slope: float) -> float:
    """Offset of a ray at a depth behind the axis: it enters the cylinder at −√(R² − u²) and oscillates in both axes."""
    enter, rate = -np.sqrt(RADIUS**2 - u**2), slope / np.sqrt(1.0 - (slope * RADIUS) ** 2)
    phase = np.linspace(0.0, np.pi, 200_001)
    along = enter * np.cos(phase) + np.sin(phase) / rate
    across = u * np.cos(phase)
    return float(np.interp(depth, along[: int(np.argmax(along))], across[: int(np.argmax(along))]))


def test_absorption_follows_beer_and_lambert(fast_device: Device) -> None:
    """The dose along a ray is the absorption there times exp(−its integral so far), by a quadrature of its own."""
    x, y = places(101, 0.06)

    def absorption(x: Any, y: Any) -> Any:
        return 0.3 + 0.2 * np.cos(0.9 * x + 0.4) * np.sin(0.8 * y + 0.3)

    medium = vam.SampledMedium(0.06, absorption=absorption(x, y))
    beam, motion = vam.Beam((49, 1), 0.08), vam.Turntable(1, lit_share=0.0)
    vial = vam.Vial(3.0, 0.2, INDEX, INDEX, INDEX, absorption=0.1)
    A = medium.operator(GRID, beam, motion, vial, rays=1, device=fast_device)
    dose = A.T(np.ones((1, 49, 1), np.float32))[:, :, 0]
    gx, gy, _ = GRID.axes()
    circle = 0.5 * 64 * 0.08
    for i, j in ((10, 32), (32, 32), (50, 40), (32, 20)):
        u, depth = gy[j], -gx[i]
        fine = np.linspace(-np.sqrt(circle**2 - u**2), depth, 20_001)
        passed = np.trapezoid(absorption(-fine, u), fine)
        resin = 0.1 * (np.sqrt(2.8**2 - u**2) - np.sqrt(circle**2 - u**2))
        expected = absorption(gx[i], u) * np.exp(-passed - resin)
        assert dose[i, j] == pytest.approx(0.08 * expected, rel=0.005)


TEXT = """
[target]
shape = "boat"
height = "1.6 mm"
pitch = "0.2 mm"
[beam]
pitch = "0.2 mm"
pixels = [24, 8]
[turntable]
angles = 12
[vial]
radius = "3.6 mm"
wall = "0.4 mm"
resin_index = 1.48
wall_index = 1.5
absorption = "0.1 /mm"
[medium]
index = "scan.npz"
absorption = "absorption.npy"
pitch = "0.15 mm"
center = ["0.2 mm", "0 mm", "0 mm"]
[solve]
method = "lbfgs"
iterations = 2
device = "cpu"
"""


@pytest.fixture
def scan(tmp_path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Arrays beside a job: indices in three dimensions, absorption that is the same at every height."""
    x, y = places(20, 0.15)
    index = 1.48 + 0.04 * np.exp(-(x**2) - y**2)[:, :, None] * np.linspace(0.2, 1.0, 12)
    absorption = (0.1 + 0.2 * np.exp(-((x - 0.3) ** 2) - y**2)).astype(np.float32)
    np.savez(tmp_path / "scan.npz", index=index, other=absorption)
    np.save(tmp_path / "absorption.npy", absorption)
    return index, absorption


def test_a_job_is_solved_and_proved_through_its_arrays(tmp_path: Path, scan: Any) -> None:
    job = Job.parse(TEXT, folder=tmp_path)
    solve(job, tmp_path / "scan.vam")
    proof = prove(tmp_path / "scan.vam").proof
    assert isinstance(proof.operator, TracedProjection) and not proof.independent
    medium = vam.SampledMedium(0.15, *scan, center=(0.2, 0.0, 0.0))._on(proof.operator.grid, 1.48, 0.1)
    assert medium.index is not None and medium.index.ndim == 3
    assert np.array_equal(np.asarray(proof.operator.medium.index), medium.index)
    assert np.array_equal(np.asarray(proof.operator.medium.extinction), np.asarray(medium.extinction))
    clear = Job.parse(TEXT.replace(TEXT[TEXT.index("[medium]") : TEXT.index("[solve]")], ""), folder=tmp_path)
    device = vam.open_device("numpy")
    plain = projection_of(clear.file, target_of(clear, device), device, tmp_path)
    light = np.random.default_rng(0).random(plain.range.shape, np.float32)
    bent, straight = proof.operator.T(light), plain.T(light)
    assert np.abs(bent - straight).max() > 0.05 * straight.max(), "index and absorption change the dose"
    assert proof.scores.iou > 0.3


@pytest.mark.parametrize(("given", "message"), [
    ({}, "neither index nor absorption"),
    ({"index": np.full((4, 4), 0.9)}, "index runs from 0.9 to 0.9; expected 1 to 5"),
    ({"absorption": np.full((4, 4), -0.1)}, "absorption runs from -0.1"),
    ({"index": np.full((4, 4), np.nan)}, "index is NaN or infinite at 16 of 16 samples"),
    ({"absorption": np.full((4, 4), 2500, np.uint16)}, "holds uint16; expected floats.*first convert"),
    ({"index": np.ones((4, 4, 4)), "center": (0.0, 0.0)}, r"center is \(0.0, 0.0\); expected 3 numbers"),
    ({"index": np.ones((4, 4)), "center": 0.0}, "center is 0.0; expected 3 numbers"),
    ({"index": np.ones(4)}, r"shape \(4,\) and holds float64"),
    ({"index": np.ones((4, 4), complex)}, "holds complex128"),
    ({"index": np.ones((0, 4))}, r"shape \(0, 4\)"),
    ({"index": np.ones((4, 4)), "center": (0.0, 0.0, 1.0)}, "center is 1 mm along z"),
    ({"index": np.ones((4, 4)), "pitch": 0.0}, "SampledMedium pitch"),
])  # fmt: skip
def test_bad_arrays_are_refused(given: dict[str, Any], message: str) -> None:
    with pytest.raises(BadInput, match=message):
        vam.SampledMedium(**{"pitch": 0.1, **given})


def test_a_medium_that_does_not_fit_is_refused(tmp_path: Path, scan: Any) -> None:
    index, _ = scan
    np.savez(tmp_path / "only.npz", index=index)
    beam, motion = vam.Beam((8, 8), 0.08), vam.Turntable(4)
    with pytest.raises(BadInput, match="the resin has none"):
        vam.SampledMedium(0.15, index).operator(GRID, beam, motion)
    with pytest.raises(BadInput, match="along x, beyond 64 voxels"):
        vam.SampledMedium(0.15, index, center=(40.0, 0.0, 0.0))._on(GRID, 1.48)
    graded = vam.GradedVial(3.0, 0.2, fish_eye(9.0), 1.5)
    with pytest.raises(BadInput, match="got GradedVial with inserts or a medium"):
        vam.SampledMedium(0.15, index).operator(GRID, beam, motion, graded)
    device = vam.open_device("numpy")
    for old, new, error, message in (
        ("[solve]", "[colors]\nabsorption = '0.1 /mm'\n[solve]", JobError, r"got \[medium\] and \[colors\]"),
        ("[solve]", "[wobble]\nacross = '0.1 mm'\n[solve]", JobError, r"got \[medium\] and \[wobble\]"),
        ("absorption.npy", "scan.npz", StorageError, "expected one named 'absorption'"),
        ("absorption.npy", "only.npz", StorageError, "holds the arrays index; expected one named 'absorption'"),
        ("absorption.npy", "none.npy", StorageError, "none.npy"),
    ):
        with pytest.raises(error, match=message):
            job = Job.parse(TEXT.replace(old, new), folder=tmp_path)
            projection_of(job.file, target_of(job, device), device, tmp_path)

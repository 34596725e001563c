"""Contracts of scans: every operator on every device with measured angles, half turns, arcs and unequal times."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
from points import PointProjection
from transposes import transpose_gap

import vamgpu as vam
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.operators.dwell import Dwell
from vamgpu.units import deg

GRID, BEAM = vam.Grid((5, 4, 2), 0.15), vam.Beam((6, 2), 0.15)
VIAL = vam.Vial(radius=1.0, wall=0.08, resin_index=1.5, wall_index=1.47, bath_index=1.0, absorption=0.5)


def jittered() -> np.ndarray:
    """Eight angles [rad], of which the third is a quarter turn from the first and the others are not."""
    angles = 2.0 * np.pi * (np.arange(8) + 0.3 * np.random.default_rng(3).uniform(-1, 1, 8)) / 8
    angles[2] = angles[0] + 0.5 * np.pi
    return angles


SCANS = {
    "jittered": lambda: vam.Turntable(jittered()),
    "half turn": lambda: vam.Turntable.arc(6, np.pi, lit_share=0),
    "arc": lambda: vam.Turntable.arc(5, 120 * deg, start=-60 * deg, lit_share=0),
    "unequal times": lambda: vam.Turntable(8, dwell=[1, 2, 3, 4, 1, 2, 0.5, 3], lit_share=0),
    "jittered, unequal": lambda: vam.Turntable(jittered(), dwell=[1, 2, 3, 4, 1, 2, 0.5, 3]),
}

OPERATORS: dict[str, Callable[[Any, Any], Any]] = {
    "straight": lambda motion, device: vam.Projection(GRID, BEAM, motion, device=device),
    "vial": lambda motion, device: vam.Projection(GRID, BEAM, motion, VIAL, device),
    "oblique": lambda motion, device: vam.Oblique(GRID, BEAM, motion, vam.Inclined(elevation=20 * deg), device=device),
    "wobbling": lambda motion, device: vam.Oblique(
        GRID, BEAM, motion, VIAL, vam.Wobble.circle(0.05, 0.3, motion), device
    ),
    "traced": lambda motion, device: vam.TracedProjection(GRID, BEAM, motion, device=device),
    "marched": lambda motion, device: vam.TracedProjection(
        GRID, BEAM, motion, rays=vam.RayBundle.parallel(BEAM, rise=0.1), device=device
    ),
    "defocused": lambda motion, device: vam.Defocused(
        vam.Projection(GRID, BEAM, motion, device=device), vam.Defocus(0.12, 0.6), tolerance=0.3
    ),
    "wobbled": lambda motion, device: vam.Wobbled(
        vam.Projection(GRID, BEAM, motion, device=device), vam.Wobble.circle(0.05, 0.3, motion)
    ),
    "tiles": lambda motion, device: vam.Tiles(vam.Projection(GRID, BEAM, motion, device=device), rows=2),
}

HARDEST = "jittered, unequal"


def pairs(*left_out: str) -> pytest.MarkDecorator:
    """Every operator with every scan; by default every operator with the hardest, and what is lit straight with all."""
    return pytest.mark.parametrize(
        ("kind", "scan"),
        [
            pytest.param(kind, scan, marks=() if scan == HARDEST or kind == "straight" else pytest.mark.slow)
            for kind in OPERATORS
            if kind not in left_out
            for scan in SCANS
        ],
    )


@cache
def images_alone(kind: str, scan: str) -> tuple[np.ndarray, np.ndarray]:
    """(volume, its image at each pose by the definition with a turntable of one pose)."""
    motions = [vam.Turntable([theta]) for theta in SCANS[scan]().poses]
    volume = np.random.default_rng(1).random(GRID.shape).astype(np.float32)
    images = [np.asarray(OPERATORS[kind](motion, "numpy")(volume), np.float64) for motion in motions]
    return volume, np.stack(images, axis=1)


@pairs()
def test_the_transpose_is_exact_entry_by_entry(device: Device, kind: str, scan: str) -> None:
    A = OPERATORS[kind](SCANS[scan](), device)
    assert transpose_gap(A, most=200) <= 3e-6


@pairs("wobbling", "wobbled")  # the place of a wobbling axis is part of the pose
def test_a_row_is_the_row_of_its_angle_alone_times_its_time(device: Device, kind: str, scan: str) -> None:
    """Poses know nothing of each other: rows are those of a turntable of one pose."""
    motion = SCANS[scan]()
    whole, (volume, alone) = OPERATORS[kind](motion, device), images_alone(kind, scan)
    images = np.asarray(whole(volume), np.float64).reshape(-1, motion.angles, *whole.range.shape[1:])
    assert np.abs(images - motion.times[:, None, None] * alone).max() <= 1e-5 * np.abs(images).max()


def test_dose_is_the_sum_of_single_poses_weighted_by_time(device: Device) -> None:
    motion = SCANS["jittered, unequal"]()
    A, rng = vam.Projection(GRID, BEAM, motion, VIAL, device), np.random.default_rng(2)
    light = rng.random(A.range.shape).astype(np.float32)
    alone = [vam.Projection(GRID, BEAM, vam.Turntable([theta]), VIAL, "numpy") for theta in motion.poses]
    wanted = sum(motion.times[k] * part.T(light[k : k + 1]) for k, part in enumerate(alone))
    assert np.abs(A.T(light) - wanted).max() <= 1e-5 * np.abs(wanted).max()
    assert motion.times.mean() == pytest.approx(1.0) and motion.times.max() > 1.5


@pytest.mark.parametrize(
    "motion",
    [
        vam.Turntable.arc(90, np.pi, lit_share=0),
        vam.Turntable.arc(91, np.pi, start=0.2, lit_share=0),
    ],
)
def test_uniform_light_over_a_half_turn_is_a_uniform_dose(device: Device, motion: vam.Turntable) -> None:
    """Parallel light that nothing absorbs is the same all along its way: half a turn does what a full one does."""
    grid, beam = vam.Grid((24, 24, 2), 0.1), vam.Beam((44, 2), 0.1, spread=0)
    opposite = vam.Turntable(np.concatenate([motion.poses, motion.poses + np.pi]))
    half, full = (vam.Projection(grid, beam, turn, device=device) for turn in (motion, opposite))
    dose = np.asarray(half.T(np.ones(half.range.shape)), np.float64) / motion.angles
    both = np.asarray(full.T(np.ones(full.range.shape)), np.float64) / opposite.angles
    assert np.abs(dose - both).max() <= 1e-5 * both.max()
    assert np.abs(dose - 0.1).max() <= 1e-3 * 0.1


def test_an_arc_does_not_light_evenly_what_absorbs(device: Device) -> None:
    """Light that fades lights the near side: an arc's dose leans towards the light, a full turn's does not."""
    motion, vat = vam.Turntable.arc(24, 120 * deg, start=-60 * deg), vam.Vat(width=2.0, absorption=0.5)
    for turn, leans in ((motion, True), (vam.Turntable(24), False)):
        A = vam.Projection(vam.Grid((16, 16, 1), 0.08), vam.Beam((32, 1), 0.08), turn, vat, device)
        dose = np.asarray(A.T(np.ones(A.range.shape)))[:, :, 0]
        lean = (dose[-6:].mean() - dose[:6].mean()) / dose.mean()  # light comes from +x at θ = 0
        assert (lean > 0.1) == leans


@pytest.mark.parametrize("scan", SCANS)
def test_points_follow_the_scan(scan: str) -> None:
    motion = SCANS[scan]()
    A = PointProjection(vam.Grid((6, 6, 1), 0.1), motion, absorption=0.4)
    assert A.dense() == pytest.approx(A.T.dense().T, abs=1e-6)  # float32 at the door
    for absorption in (0.0, 0.4):
        whole, *alone = (
            np.asarray(PointProjection(vam.Grid((6, 6, 1), 0.1), turn, absorption=absorption)(np.ones((6, 6, 1))))
            for turn in (motion, *(vam.Turntable([theta]) for theta in motion.poses))
        )
        assert whole == pytest.approx(motion.times[:, None, None] * np.concatenate(alone), rel=1e-5)


def test_tiles_repeat_the_times_of_a_turn(device: Device) -> None:
    motion = SCANS["unequal times"]()
    images = np.ones((24, 3, 5), np.float32)
    beam = vam.Beam((3, 5), 0.1)
    weighted = Dwell(motion, beam, device).weighted(device.upload(images)).numpy()
    assert weighted == pytest.approx(np.tile(motion.times, 3)[:, None, None] * images, rel=1e-6)
    same = device.upload(images)
    assert Dwell(vam.Turntable(8), beam, device).weighted(same) is same


def test_webs_refuse_a_turntable() -> None:
    grid: Any = vam.WebGrid((8, 4, 3), (0.1, 0.1, 0.1))
    with pytest.raises(BadInput, match=r"got Turntable\(.* where a Wrap is expected"):
        vam.WebProjection(grid, BEAM, SCANS["half turn"]())  # type: ignore[arg-type]

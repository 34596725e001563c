"""Proofs by bit planes: each plane of a frame at the angles at which a rig shows it."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

import vamgpu as vam
from vamgpu.errors import BadInput
from vamgpu.geometry import PlaneTime
from vamgpu.hosts.schedules.limits import HdmiTiming, MirrorTiming
from vamgpu.hosts.schedules.mirrors import turned
from vamgpu.hosts.schedules.schedule import plane_times
from vamgpu.hosts.schedules.video import vial
from vamgpu.printing.frames import Frames
from vamgpu.printing.gray import GrayCurve
from vamgpu.printing.independent_exposure import IndependentExposure
from vamgpu.printing.planes import prove_planes
from vamgpu.printing.proof import Proof

EVENLY = tuple(PlaneTime(bit, -0.25, 0.5) for bit in range(8))


def _proof(levels: np.ndarray | None = None, gray: GrayCurve | None = None) -> Proof:
    """A bar before 12 angles, and levels without any order."""
    grid, beam = vam.Grid((12, 12, 2), 0.2), vam.Beam((20, 2), 0.2)
    A = vam.Projection(grid, beam, vam.Turntable(12, lit_share=0.5), None, "numpy")
    if levels is None:
        levels = np.random.default_rng(5).integers(0, 256, (12, 2, 20)).astype(np.uint8)
    frames = Frames.from_bytes(
        levels, "numpy", bits=8, gray=gray or GrayCurve.linear(0.01), scale=2.0, columns=20, motion=A.motion
    )
    target = np.zeros(A.grid.shape)
    target[4:8, 5:7] = 1.0
    return vam.simulate(A, frames, target)


@pytest.mark.parametrize("gray", [GrayCurve.linear(0.02), GrayCurve.gamma(2.2)])
def test_planes_that_are_lit_all_the_time_change_nothing(gray: GrayCurve) -> None:
    proof = _proof(gray=gray)
    found = prove_planes(proof, EVENLY)
    assert found.off <= 1e-6 and found.window == pytest.approx(proof.scores.window, abs=1e-6)


def test_a_plane_is_exposed_at_the_angles_at_which_it_is_lit() -> None:
    """Frames of the highest bit alone, lit for the first half of the step, are those of a vial a quarter step back."""
    proof = _proof((np.random.default_rng(5).integers(0, 2, (12, 2, 20)) * 128).astype(np.uint8), GrayCurve.linear())
    A, planes = proof.operator, [PlaneTime(bit, -0.5 if bit == 7 else 0.0, 0.5) for bit in range(8)]
    found = prove_planes(proof, planes)
    step = 2.0 * np.pi / 12
    motion = vam.Turntable([*(A.motion.poses - 0.25 * step)], lit_share=0.5)
    moved = vam.Projection(A.grid, A.beam, motion, None, "numpy")
    light = proof.frames.irradiance(A.device)
    wanted = IndependentExposure(moved, finer=IndependentExposure(A).finer).averaged(light)[0].numpy()
    off = np.abs(wanted - proof.dose.numpy())[A.grid.cylinder()].max() / proof.scores.peak
    assert found.off == pytest.approx(off, rel=1e-3) and found.off > 0.02
    lines = {line.name: line.value for line in vam_lines(proof, found)}
    assert lines["window, bit planes"] == f"{found.window:+.4f}"


def vam_lines(proof: Proof, found: object) -> tuple:
    from dataclasses import replace

    return replace(proof, planes=found).lines()  # pyright: ignore[reportArgumentType]


def test_planes_that_lack_a_bit_are_refused() -> None:
    with pytest.raises(BadInput, match="bits 0 to 7"):
        prove_planes(_proof(), EVENLY[1:])


def test_planes_run_from_the_highest_bit_for_as_long_as_they_are_worth() -> None:
    """Behind a trigger once, on a cable in every slot of a frame; about the middle of the light."""
    mirrors = MirrorTiming(frame={8: Fraction(1, 1000)})
    table = turned(90, speed=40, engines=mirrors, bits=8)
    once = plane_times(table, 8)
    assert [plane.bit for plane in once] == [7, 6, 5, 4, 3, 2, 1, 0]
    lit = int(table.on[0]) / float(table.cadence.period)
    assert once[0].begin == pytest.approx(-0.5 * lit) and once[0].width == pytest.approx(lit * 128 / 255)
    assert once[-1].begin + once[-1].width == pytest.approx(0.5 * lit)
    display = HdmiTiming()
    table = vial(120, speed=120, display=display)
    again = plane_times(table, 8, display)
    assert len(again) == 8 * 3 and sum(plane.width for plane in again) == pytest.approx(1.0)
    assert again[8].begin == pytest.approx(-0.5 + 1 / 3)

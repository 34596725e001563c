"""How fine light is in the resin, and what is told where voxels or angles are coarser."""

from __future__ import annotations

import warnings
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import vamgpu as vam
from vamgpu.errors import SamplingWarning
from vamgpu.methods.part import radius_of
from vamgpu.optics.index_field import FormulaField
from vamgpu.optics.sampling import sampling_notes
from vamgpu.printing.report import _setup

BEAM = vam.Beam((100, 50), 0.06)
VIAL = vam.Vial(radius=12.4, wall=1.0, resin_index=1.5, wall_index=1.473)


@pytest.mark.parametrize(
    ("light", "across", "along"),
    [
        (None, 0.06, 0.06),
        (vam.Vat(20.0), 0.06, 0.06),
        (VIAL, 0.04, 0.06),  # by Snell's law for rays near the axis, whatever the wall
        (vam.Misaligned(VIAL, offset=0.3), 0.04, 0.06),
        (vam.Fan(VIAL, throw=300.0), 0.04, 0.06),
        (vam.Inclined(elevation=0.6), 0.06, 0.06 / 0.8253356),
        (vam.GradedVial(12.4, 1.0, FormulaField((1.0, 1.0, 0.0), (1.5**2,)), 1.473), 0.04, 0.06),
    ],
)
def test_a_pixel_in_the_resin(light, across: float, along: float) -> None:
    assert vam.resin_pixel(BEAM, light) == pytest.approx((across, along), rel=1e-4)


def turned(angles, lit_share: float | None, pitch: float = 0.04) -> tuple[str, ...]:
    """What is told of a part of 4 mm about the axis in that vial."""
    grid, motion = vam.Grid((8, 8, 8), pitch), vam.Turntable(angles, lit_share=lit_share)
    operator: Any = SimpleNamespace(grid=grid, beam=BEAM, motion=motion, vessel=VIAL)
    return sampling_notes(operator, 4.0)


@pytest.mark.parametrize(("lit_share", "least"), [(1.0, 157.1), (0.8, 125.7), (0.2, 78.5), (0.0, 78.5)])
def test_angles_do_where_no_point_moves_farther_than_four_pixels(lit_share: float, least: float) -> None:
    """2π · 4 mm over pixels of 40 µm are 157 steps of four pixels each."""
    enough = vam.enough_angles(BEAM, VIAL, 4.0, lit_share)
    assert enough == 60 * int(np.ceil(least / 60.0)) == vam.enough_angles(BEAM, VIAL, "4 mm", lit_share)
    assert turned(enough, lit_share) == ()
    (note,) = turned(int(0.9 * least), lit_share)
    assert f"{int(0.9 * least)} angles are few for a part of 4 mm" in note and f"use {enough} angles" in note
    assert "pixels are 40 µm wide in the resin" in note


def test_angles_of_a_part_of_a_turn_are_told_by_their_steps() -> None:
    half = np.linspace(0.0, np.pi, 400, endpoint=False)
    assert turned(half, 1.0) == ()
    assert turned(half[::8], 0.0) == () and "use 60 angles" in turned(half[::16], 0.0)[0]


def test_voxels_wider_than_a_pixel_are_told() -> None:
    (note,) = turned(660, 1.0, pitch=0.06)
    assert note.startswith("voxels of 60 µm are wider than a pixel in the resin, 40 µm")


def test_a_plan_keeps_what_is_too_coarse(tmp_path) -> None:
    target = vam.Target.from_array(np.pad(np.ones((8, 8, 2)), ((8, 8), (8, 8), (1, 1))), 0.1)
    vial = vam.Vial(radius=3.0, wall=0.2, resin_index=1.5, wall_index=1.47, absorption=0.1)
    for angles, pitch in ((6, 0.1), (60, 0.2)):
        A = vam.Projection(target.grid, vam.Beam((48, 6), pitch), vam.Turntable(angles), vial, "cpu")
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            plan = vam.optimize(A, target, "recipe", iterations=1)
        told = [str(each.message) for each in caught if each.category is SamplingWarning]
        assert tuple(told) == plan.notes == sampling_notes(A, target.radius)
        assert len(told) == (2 if angles == 6 else 0)
        assert all(each.filename == __file__ for each in caught if each.category is SamplingWarning)
        proof = vam.simulate(A, vam.pack(plan), target)
        assert tuple(value for name, value in _setup(proof, plan) if name == "note") == plan.notes
        place = plan.save(tmp_path / f"{angles}.vam")
        again = vam.load(place, "cpu")
        assert isinstance(again, vam.Plan) and again.notes == plan.notes


def test_the_radius_of_an_array_is_that_of_its_part(device) -> None:
    grid = vam.Grid((40, 40, 4), 0.1)
    x, y, _ = grid.axes()
    part = np.zeros(grid.shape, np.float32)
    part[(np.hypot(x[:, None] - 0.4, y[None, :]) < 0.8), 1:3] = 0.6
    wanted = np.hypot(x[:, None], y[None, :])[part[:, :, 1] > 0].max()
    A = vam.Projection(grid, vam.Beam((40, 4), 0.1), vam.Turntable(4), device=device)
    assert radius_of(A, part, device.upload(part)) == pytest.approx(wanted, abs=0.06)

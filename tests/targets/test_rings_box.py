"""Targets for rings: voxels of their box."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

import vamgpu as vam
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.targets.solid import Solid

RINGS = vam.PolarGrid(16, 8, 0.1, 48)
LOW, HIGH = np.array([-0.43, 0.11, -0.23]), np.array([0.82, 0.97, 0.23])


def box(drawn: bool = True) -> Solid:
    unit = trimesh.creation.box((1.0, 1.0, 1.0))
    corners = np.where(np.asarray(unit.vertices) > 0, HIGH, LOW)
    return Solid(corners, np.asarray(unit.faces), "box", drawn=drawn)


def test_rings_give_a_target_their_box(device: Device) -> None:
    target = vam.Target.from_mesh(box(), factor=1.0, grid=RINGS, margin=0, device=device)
    assert target.grid == RINGS.box


def test_rings_within_a_box_reach_its_cylinder() -> None:
    rings = vam.PolarGrid.within(vam.Grid((50, 48, 5), 0.1), 12)
    assert (rings.rings, rings.slices, rings.pitch, rings.angles) == (24, 6, 0.1, 12)


def test_what_does_not_go_together_is_refused() -> None:
    with pytest.raises(BadInput, match="with a grid"):
        vam.Target.from_mesh(box(), factor=1.0, pitch=0.1, grid=RINGS)
    with pytest.raises(BadInput, match="neither pitch nor grid"):
        vam.Target.from_mesh(box(), factor=1.0)
    with pytest.raises(BadInput, match="PolarGrid"):
        vam.Target.from_mesh(box(), factor=1.0, grid=0.1)  # pyright: ignore[reportArgumentType]

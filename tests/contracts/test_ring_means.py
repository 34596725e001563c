"""Means between voxels and cells of rings: exact transposes, and what is constant stays so."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import vamgpu as vam
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.operators.ring_means import ToRings, ToVoxels

BOX = vam.Grid((40, 36, 6), 0.1)
GEOMETRIES = {
    "the same slices": vam.PolarGrid(16, 6, 0.1, 30),
    "beyond the box": vam.PolarGrid(24, 4, 0.1, 30),
    "other slices, several bands": vam.PolarGrid(16, 8, 0.13, 7),
}
every_geometry = pytest.mark.parametrize("rings", GEOMETRIES.values(), ids=GEOMETRIES)


@every_geometry
def test_transposes_are_exact(device: Device, rings: vam.PolarGrid) -> None:
    for A in (ToRings(BOX, rings, device), ToVoxels(rings, BOX, device)):
        assert A.dot_test() <= 1e-8


@every_geometry
def test_devices_agree(device: Device, rings: vam.PolarGrid) -> None:
    x = np.random.default_rng(0).random(BOX.shape)
    for make in (lambda place: ToRings(BOX, rings, place), lambda place: ToVoxels(rings, BOX, place).T):
        wanted = make("numpy")(x)
        assert np.abs(make(device)(x) - wanted).max() <= 1e-6 * wanted.max()


@every_geometry
def test_what_is_constant_stays_so(rings: vam.PolarGrid) -> None:
    on_rings = ToRings(BOX, rings, "numpy")(np.ones(BOX.shape))
    high = np.abs(rings.z) + 0.5 * rings.pitch <= 0.3 + 1e-9  # within the slices of the box
    inner = rings.places[0] + 0.5 * rings.pitch <= 1.8 - 0.1
    assert np.allclose(on_rings[:, inner][:, :, high], 1.0, atol=1e-6)
    back = ToVoxels(rings, BOX, "numpy")(np.ones(rings.shape))
    x, y, z = BOX.axes()
    inside = np.hypot(x[:, None], y) + 0.1 <= rings.rings * rings.pitch
    held = np.abs(z) + 0.05 <= 0.5 * rings.slices * rings.pitch + 1e-9
    assert np.allclose(back[inside][:, held], 1.0, atol=1e-6)


def test_a_smooth_field_changes_by_less_than_over_half_a_voxel() -> None:
    grid, rings = vam.Grid((64, 64, 2), 0.1), vam.PolarGrid(32, 2, 0.1, 96)
    wave = 2.0 * np.pi / 1.6
    x, y, _ = grid.axes()
    field = np.sin(wave * x)[:, None] * np.cos(wave * y)
    volume = field[:, :, None].repeat(2, axis=2)
    rho, phi = rings.places
    there = np.asarray(ToRings(grid, rings, "numpy")(volume))
    wanted = np.sin(wave * rho * np.cos(phi)) * np.cos(wave * rho * np.sin(phi))
    inner = rho < 3.0
    assert np.abs(there[:, inner, 0] - wanted[:, inner]).max() <= 0.5 * wave * 0.1
    back = np.asarray(ToVoxels(rings, grid, "numpy")(there))
    off = (back[:, :, 0] - field)[np.hypot(x[:, None], y) < 3.0]
    assert np.sqrt((off**2).mean()) <= 0.025


def test_other_kinds_are_refused() -> None:
    wrong: Any = BOX
    with pytest.raises(BadInput, match="PolarGrid"):
        ToRings(BOX, wrong)

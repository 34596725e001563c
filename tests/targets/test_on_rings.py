"""Fractions of the cells of rings, against points of the part itself."""

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


def filled_by_points(rings: vam.PolarGrid, count: int = 48) -> np.ndarray:
    """The part of every cell in the box, by count × count points of it; exactly along z."""
    found, (ahead, behind) = np.zeros(rings.shape), (np.arange(count) + 0.5, count)
    edges = (np.arange(rings.slices + 1) - 0.5 * rings.slices) * rings.pitch
    high = np.clip(np.minimum(edges[1:], HIGH[2]) - np.maximum(edges[:-1], LOW[2]), 0.0, None) / rings.pitch
    for band in rings.bands:
        for ring in range(band.begin, band.stop):
            rho = np.sqrt(ring**2 + ahead / behind * (2 * ring + 1)) * rings.pitch
            for q in range(band.samples):
                start = np.arange(rings.angles)[:, None] * band.samples + q
                turn = 2.0 * np.pi / (rings.angles * band.samples) * (start + ahead / behind - 0.5)
                x, y = rho[:, None, None] * np.cos(turn), rho[:, None, None] * np.sin(turn)
                inside = (x > LOW[0]) & (x < HIGH[0]) & (y > LOW[1]) & (y < HIGH[1])
                found[:, band.cell + q * band.rings + ring - band.begin] = inside.mean(axis=(0, 2))[:, None] * high
    return found


def test_a_mesh_fills_cells_as_its_points_do(device: Device) -> None:
    target = vam.Target.from_mesh(box(), factor=1.0, grid=RINGS, margin=0, device=device)
    assert target.grid == RINGS.box
    got, wanted = target.on_rings(RINGS, device).numpy(), filled_by_points(RINGS)
    cut = (wanted > 0.0) & (wanted < 1.0)
    off = (got - wanted)[cut]
    assert np.sqrt((off**2).mean()) <= 0.025 and np.abs(off).max() <= 0.15
    volume = (got * RINGS.areas[None, :, None]).sum() * RINGS.pitch**3
    assert volume == pytest.approx(float(np.prod(HIGH - LOW)), rel=3e-3)
    assert target.on_rings(RINGS, device) is target.on_rings(RINGS, device)


def test_an_array_keeps_its_volume_on_rings() -> None:
    values = np.random.default_rng(0).random((20, 22, 6)) * (np.hypot(*np.mgrid[-9.5:10, -10.5:11]) < 9.0)[:, :, None]
    target = vam.Target.from_array(values, 0.12)
    got = target.on_rings(RINGS, "numpy").numpy()
    assert got.min() >= 0.0 and got.max() <= 1.0
    volume = (got * RINGS.areas[None, :, None]).sum() * RINGS.pitch**3
    assert volume == pytest.approx(target.volume, rel=3e-3)


def test_rings_within_a_box_reach_its_cylinder() -> None:
    rings = vam.PolarGrid.within(vam.Grid((50, 48, 5), 0.1), 12)
    assert (rings.rings, rings.slices, rings.pitch, rings.angles) == (24, 6, 0.1, 12)


def test_what_does_not_go_together_is_refused() -> None:
    with pytest.raises(BadInput, match="with a grid"):
        vam.Target.from_mesh(box(), factor=1.0, pitch=0.1, grid=RINGS)
    with pytest.raises(BadInput, match="neither pitch nor grid"):
        vam.Target.from_mesh(box(), factor=1.0)
    with pytest.raises(BadInput, match="PolarGrid"):
        vam.Target.from_mesh(box(), factor=1.0, pitch=0.1, device="numpy").on_rings(RINGS.box)  # pyright: ignore[reportArgumentType]

"""Bent light where tables end: the margin within which a gather looks for voxels, and the rim of the lit cylinder."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

from vamgpu import Beam, Grid, Oblique, Projection, Turntable, Vial
from vamgpu.backend.device import Device

RESIN = 1.49962


def vial(bath: float) -> Vial:
    return Vial(radius=12.4, wall=1.0, resin_index=RESIN, wall_index=1.473, bath_index=bath, absorption=0.05)


FINE = Grid((112, 112, 4), 16.6 / 112)


@cache
def as_wide(ratio: float, device: str) -> tuple[Any, np.ndarray, np.ndarray]:
    """(scene, volume, its light on a device), in air, where light bends most, with no point spread."""
    beam = Beam((180, 4), ratio * FINE.pitch, spread=0.0)  # across the whole vial
    scene = FINE, beam, Turntable(2), vial(1.0)
    volume = np.random.default_rng(0).random(FINE.shape).astype(np.float32)
    return scene, volume, np.asarray(Projection(*scene, device)(volume))


@pytest.mark.parametrize("ratio", [pytest.param(0.99, marks=pytest.mark.slow), 1.0])
@pytest.mark.slow
def test_no_voxel_is_missed_where_columns_are_as_wide_as_voxels(
    fast_device: Device, processor: str, ratio: float
) -> None:
    """Through a perfect lens, whose light ends most abruptly: what gathers along rays against a processor, which looks
    at every voxel. A reach 0.9 times as far shows as 7e-5.
    """
    scene, volume, light = as_wide(ratio, processor)
    A = Projection(*scene, fast_device)  # pyright: ignore[reportCallIssue]
    assert np.abs(A(volume) - light).max() < 3e-6 * light.max()
    assert A.dot_test() < 5e-8


@pytest.mark.parametrize("ratio", [pytest.param(0.99, marks=pytest.mark.slow), 1.0])
def test_no_voxel_is_missed_where_columns_are_followed_one_by_one(fast_device: Device, ratio: float) -> None:
    """Rounding leaves 8e-9; a gather that does not look as far as its map strays from the rays, 3e-5."""
    grid = Grid((64, 64, 2), 16.6 / 64)
    assert (
        Oblique(grid, Beam((102, 2), ratio * grid.pitch), Turntable(3), vial(1.0), device=fast_device).dot_test() < 5e-8
    )


@pytest.mark.parametrize(
    ("pitch", "voxels", "columns", "column"),
    [(2.5, 6, 9, 2.5), (1.7, 10, 14, 1.7), (0.8, 20, 30, 0.8), (0.3, 40, 60, 0.3), (0.1, 16, 4, 6.0)],
)
def test_no_voxel_is_missed_where_columns_fan_out(
    device: Device, pitch: float, voxels: int, columns: int, column: float
) -> None:
    """Coarse columns, whose rays are up to tens of degrees from their neighbors': some cross, and some leave the space
    between the first and the last of four.
    """
    scene = (Grid((voxels, voxels + 1, 4), pitch), Beam((columns, 4), column), Turntable(7), vial(1.0))
    A, reference = Projection(*scene, device), Projection(*scene, "numpy")
    volume = np.random.default_rng(0).random(A.domain.shape)
    light = reference(volume)
    assert np.abs(A(volume) - light).max() < 2e-5 * light.max()
    assert A.dot_test() < 5e-8


@pytest.mark.parametrize("bath", [1.0, 1.33, 1.45])
def test_voxels_at_the_rim_are_lit_by_the_column_that_meets_them(device: Device, bath: float) -> None:
    """At a pose between the axes of the grid, whose voxels lie between samples of any map of the light.

    One voxel a slice, centers within a voxel of where light ends; the column that light of each falls on, its centroid,
    is the one of the ray through its center up to half a voxel.
    """
    vessel, n = vial(bath), 48
    pitch = 2.0 * 1.08 * vessel.lit_radius / n
    x = (np.arange(n) - 0.5 * (n - 1)) * pitch
    distance = np.hypot(x[:, None], x)
    chosen = np.argwhere((distance > vessel.lit_radius - pitch) & (distance < vessel.lit_radius))
    assert len(chosen) > 100
    voxels = np.zeros((n, n, len(chosen)), np.float32)
    voxels[chosen[:, 0], chosen[:, 1], np.arange(len(chosen))] = 1.0
    beam = Beam((n + n // 2, len(chosen)), pitch, spread=0.0)
    operator = Projection(Grid(voxels.shape, pitch), beam, Turntable(16, lit_share=0), vessel, device)
    light = np.asarray(operator(voxels))[1].astype(np.float64)  # [column, voxel]

    turn = 2.0 * np.pi / 16
    at, along = x[chosen[:, 0]], x[chosen[:, 1]]
    across, deep = along * np.cos(turn) - at * np.sin(turn), -(at * np.cos(turn) + along * np.sin(turn))
    u, weight = vessel.illuminate(across, deep)
    assert (weight > 0.0).all() and np.abs(u).max() < beam.columns()[-1] - pitch
    assert (light.sum(axis=0) > 0.0).all()
    column = (beam.columns() @ light) / light.sum(axis=0)
    assert np.abs(column - u).max() < 0.5 * pitch

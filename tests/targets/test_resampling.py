"""A target on other voxels: exact averages of an array, and a solid that is voxelized again."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.geometry import Grid
from vamgpu.targets.resampling import averaged
from vamgpu.targets.solid import Solid
from vamgpu.targets.target import Target

SHIFT = (0.05, -0.025, 0.075)


def numbers(shape: tuple[int, int, int]) -> np.ndarray:
    return np.random.default_rng(5).random(shape)


def fine_sum(values: np.ndarray, grid: Grid, other: Grid, shift: tuple[float, float, float]) -> np.ndarray:
    """The mean over every voxel of other by brute force: interval overlaps of all pairs, in float64."""
    for axis, move in enumerate(shift):
        old = (np.arange(grid.shape[axis] + 1) - 0.5 * grid.shape[axis]) * grid.pitch
        new = (np.arange(other.shape[axis] + 1) - 0.5 * other.shape[axis]) * other.pitch + move
        overlap = np.minimum(new[1:, None], old[None, 1:]) - np.maximum(new[:-1, None], old[None, :-1])
        values = np.moveaxis(np.tensordot(np.maximum(overlap, 0.0) / other.pitch, values, (1, axis)), 0, axis)
    return values


@pytest.mark.parametrize(
    ("shape", "pitch"), [((17, 15, 11), 0.1), ((9, 8, 7), 0.31), ((40, 33, 5), 0.07), ((3, 90, 2), 0.05)]
)
def test_an_array_is_averaged_exactly(shape: tuple[int, int, int], pitch: float, device: Device) -> None:
    grid, other = Grid((12, 10, 9), 0.2), Grid(shape, pitch)
    values = numbers(grid.shape)
    got = Target.from_array(values, grid.pitch).resampled(other, SHIFT, device)
    assert got.device is device
    np.testing.assert_allclose(got.numpy(), fine_sum(values, grid, other, SHIFT), atol=3e-7)


def test_the_same_voxels_give_the_same_fractions_and_halves_are_exact() -> None:
    grid = Grid((6, 8, 10), 0.1)
    values = (numbers(grid.shape) > 0.5).astype(np.float32)
    target = Target.from_array(values, grid.pitch)
    np.testing.assert_array_equal(target.resampled(grid, device="numpy").numpy(), values)
    halves = averaged(values, grid, Grid((24, 16, 20), 0.05), (0.025, 0.025, 0.025))
    assert set(np.unique(halves)) <= set((np.arange(9) / 8).tolist())


def test_a_slab_elsewhere_is_that_slab_and_far_away_is_empty() -> None:
    grid, fine = Grid((6, 8, 10), 0.1), Grid((12, 16, 20), 0.05)
    target = Target.from_array(numbers(grid.shape), grid.pitch)
    whole = target.resampled(fine, device="numpy").numpy()
    slab = target.resampled(Grid((12, 16, 6), 0.05), (0.0, 0.0, (4 + 3 - 10) * 0.05), "numpy").numpy()
    np.testing.assert_allclose(slab, whole[:, :, 4:10], atol=1e-6)
    assert not target.resampled(fine, (0.0, 0.0, 9.0), "numpy").numpy().any()


def test_a_solid_is_voxelized_again(device: Device) -> None:
    mesh = trimesh.creation.icosphere(2, 1.0)
    ball = Solid(np.asarray(mesh.vertices) + (3.0, 0.0, 1.0), np.asarray(mesh.faces), "ball")
    target = Target.from_mesh(ball, height=2.0, pitch=0.25, device=device)
    assert target.solid is not None and target.solid.radius == pytest.approx(target.radius)
    np.testing.assert_array_equal(target.resampled(target.grid, device=device).numpy(), target.numpy())
    fine = Grid((24, 22, 20), 0.125)
    got = target.resampled(fine, SHIFT, device).numpy()
    x, y, z = (axis + move for axis, move in zip(fine.axes(), SHIFT, strict=True))
    distance = np.sqrt(x[:, None, None] ** 2 + y[None, :, None] ** 2 + z[None, None, :] ** 2)
    assert (got[distance < 0.97 - 0.125] == 1.0).all() and (got[distance > 1.0 + 0.125] == 0.0).all()
    assert got.sum() * 0.125**3 == pytest.approx(target.solid.volume, rel=1e-3)
    middle = np.array([(got * axis).sum() for axis in np.broadcast_arrays(*np.ix_(x, y, z))]) / got.sum()
    np.testing.assert_allclose(middle, 0.0, atol=2e-3)  # moved the right way
    assert not target.resampled(fine, (0.0, 9.0, 0.0), device).numpy().any()


@pytest.mark.parametrize("shift", [(0.0, 1.0), (0.0, 0.0, float("nan")), 1.0])
def test_a_shift_that_is_none_is_refused(shift: object) -> None:
    with pytest.raises(BadInput, match="three finite lengths"):
        Target.from_array(np.ones((2, 2, 2)), 1.0).resampled(Grid((2, 2, 2), 1.0), shift)  # type: ignore[arg-type]

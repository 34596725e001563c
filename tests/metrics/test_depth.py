"""Depths from fractions against spheres, planes and boxes, whose depths are known."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt

import vamgpu
from vamgpu.backend.slabs import SlabDevice
from vamgpu.errors import BadInput
from vamgpu.metrics.depth import signed_depth

SHAPE = (44, 42, 40)
REACH = 4.0
Field = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def sampled(depth: Field, fine: int = 6) -> tuple[np.ndarray, np.ndarray]:
    """Fractions of voxels, counted on finer points, and the true depths of their centers."""
    axes = np.meshgrid(*(np.arange(n) - 0.5 * (n - 1) for n in SHAPE), indexing="ij")
    steps = (np.arange(fine) + 0.5) / fine - 0.5
    filled = sum((depth(*(a + d for a, d in zip(axes, move, strict=True))) > 0) for move in product(steps, repeat=3))
    return np.asarray(filled / fine**3), depth(*axes)


def sphere(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    return 12.3 - np.sqrt((x - 0.2) ** 2 + (y + 0.35) ** 2 + (z - 0.1) ** 2)


def plane(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    return (2 * x + 3 * y - 6 * z) / 7 + 0.21


def brick(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    x, y = np.cos(0.4) * x + np.sin(0.4) * y, np.cos(0.4) * y - np.sin(0.4) * x
    beyond = np.stack([np.abs(a) - half for a, half in ((x, 11.2), (y, 9.7), (z, 8.4))])
    return -np.linalg.norm(np.maximum(beyond, 0), axis=0) - np.minimum(beyond.max(axis=0), 0)


def errors(found: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Of the depths below the reach, away from the ends of the grid."""
    middle = (slice(7, -7),) * 3
    return (found - true)[middle][np.abs(true[middle]) < REACH - 0.2]


@pytest.mark.parametrize(("depth", "rms"), [(sphere, 0.035), (plane, 0.035), (brick, 0.085)])
def test_depths_are_right_to_a_small_part_of_a_voxel(depth: Field, rms: float) -> None:
    fraction, true = sampled(depth)
    found = signed_depth(fraction, REACH)
    error = errors(found, true)
    whole = fraction >= 0.5
    inner, outer = (np.asarray(distance_transform_edt(side)) - 0.5 for side in (whole, ~whole))
    between_centers = np.where(whole, inner, -outer)
    assert np.sqrt(np.mean(error**2)) < rms < 0.34 * np.sqrt(np.mean(errors(between_centers, true) ** 2))
    assert np.array_equal(found >= 0, whole)
    assert found.max() <= REACH and found.min() == -REACH


@pytest.mark.parametrize("offset", [0.0, 0.13, 0.25, 0.49])
def test_a_plane_along_the_voxels_is_found_exactly(offset: float) -> None:
    x = np.arange(24) - 11.5
    for axis in range(3):
        fraction = np.moveaxis(np.broadcast_to(np.clip(x + offset + 0.5, 0, 1)[:, None, None], (24, 6, 5)), 0, axis)
        found = np.moveaxis(signed_depth(fraction, REACH), axis, 0)
        wanted = np.clip(x + offset, -REACH, REACH)
        inner = np.abs(x) < 7
        assert np.abs(found - wanted[:, None, None])[inner].max() < 1e-3


def test_slabs_with_a_halo_agree_with_the_whole() -> None:
    fraction, _ = sampled(brick, 3)
    whole, halo = signed_depth(fraction, REACH), 7
    for start in range(0, SHAPE[2], 8):
        low = max(start - halo, 0)
        part = signed_depth(fraction[:, :, low : start + 8 + halo], REACH)
        assert np.abs(part[:, :, start - low : start - low + 8] - whole[:, :, start : start + 8]).max() < 0.15
        assert np.mean(part[:, :, start - low : start - low + 8] != whole[:, :, start : start + 8]) < 1e-3


def test_blocks_of_slices_give_the_same_depths(monkeypatch: pytest.MonkeyPatch) -> None:
    """The upper face lies in slice 28: depths of slice 32, the first of a block, need slices below it."""
    fraction, _ = sampled(brick, 3)
    whole = signed_depth(fraction, REACH + 0.5)
    monkeypatch.setattr("vamgpu.metrics.depth.TOGETHER", 0)
    monkeypatch.setattr("vamgpu.metrics.depth.FEWEST", 8)
    assert np.array_equal(signed_depth(fraction, REACH + 0.5), whole)


def test_devices_that_share_a_part_measure_slabs_of_their_own(monkeypatch: pytest.MonkeyPatch) -> None:
    members = [vamgpu.open_device("numpy") for _ in range(3)]
    monkeypatch.setattr(SlabDevice, "_run_whole", None)
    fraction = np.random.default_rng(1).random((9, 8, 20)).round()
    shared = signed_depth(fraction, REACH, SlabDevice("three", members))
    assert np.array_equal(shared, signed_depth(fraction, REACH, members[0]))


def test_both_sides_of_a_face_between_full_and_empty_are_a_surface() -> None:
    """Around a full voxel each of its neighbors knows the face; from the voxel alone the distance would be 1.49."""
    fraction = np.zeros((9, 9, 9))
    fraction[4, 4, 4] = 1.0
    found = signed_depth(fraction, 3.0)
    for axis in range(3):
        assert np.moveaxis(found, axis, 0)[[2, 6], 4, 4] == pytest.approx([-1.5, -1.5], abs=1e-4)


def test_nothing_and_everything() -> None:
    assert (signed_depth(np.zeros((5, 6, 7)), 3.0) == -3).all()
    assert (signed_depth(np.ones((5, 6, 7)), 3.0) == 3).all()


def test_a_sheet_thinner_than_half_a_voxel_is_outside_everywhere_and_yet_a_surface() -> None:
    fraction = np.zeros((9, 9, 9))
    fraction[:, :, 4] = 0.3
    found = signed_depth(fraction, 3.0)
    assert (found < 0).all() and np.abs(found[:, :, 4]).max() < 0.3 and found[4, 4, 7] == pytest.approx(-3.0, abs=0.3)


def test_wrong_input_is_refused() -> None:
    with pytest.raises(BadInput, match=r"shape \(3, 3\)"):
        signed_depth(np.zeros((3, 3)), 2.0)
    with pytest.raises(BadInput, match="at most 12"):
        signed_depth(np.zeros((3, 3, 3)), 13.0)

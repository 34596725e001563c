"""Runs of voxels against the volumes that they stand for."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import find_objects, label

from vamgpu.metrics.runs import Runs, runs_of
from vamgpu.metrics.topology import topology

SHAPES = ((1, 1, 9), (9, 1, 4), (1, 6, 1), (5, 7, 11), (8, 3, 2))


def noise(shape: tuple[int, int, int], seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).random(shape) > 0.4


def dense(runs: Runs) -> np.ndarray:
    return runs.holds(np.argwhere(np.ones(runs.shape, bool))).reshape(runs.shape)


@pytest.mark.parametrize("shape", SHAPES)
def test_runs_and_gaps_are_the_volume_and_the_rest(shape: tuple[int, int, int]) -> None:
    for mask in (noise(shape), np.ones(shape, bool), np.zeros(shape, bool)):
        runs = runs_of(mask)
        assert np.array_equal(dense(runs), mask) and np.array_equal(dense(runs.gaps()), ~mask)
        assert runs.length.sum() == mask.sum()
    values = noise(shape) * 0.5
    assert np.array_equal(dense(runs_of(values, 0.5)), values >= 0.5)


def test_volumes_of_several_pieces_are_read_in_order(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("vamgpu.metrics.runs._PIECE", 200)
    mask = noise((23, 5, 11))
    assert np.array_equal(dense(runs_of(mask)), mask)


def test_the_box_and_the_volume_in_another() -> None:
    mask = np.zeros((7, 8, 9), bool)
    mask[2:4, 3:7, 1:6] = noise((2, 4, 5))
    low, high = runs_of(mask).box
    box = find_objects(mask.astype(int))[0]
    assert [(a, b) for a, b in zip(low, high, strict=True)] == [(cut.start, cut.stop) for cut in box]
    moved = runs_of(mask).moved(np.array([1, -2, 0]), (5, 11, 7))
    assert np.array_equal(dense(moved)[1:3, 5:9, 1:6], mask[2:4, 3:7, 1:6]) and moved.length.sum() == mask.sum()


def test_shared_voxels_of_neighbors() -> None:
    one, other = noise((6, 5, 12)), noise((6, 5, 12), 1)
    a, b = runs_of(one), runs_of(other)
    for step, moved in ((0, one), (a.step_x, np.roll(one, 1, 0)), (a.step_y, np.roll(one, 1, 1))):
        moved[0] &= step != a.step_x
        moved[:, 0] &= step != a.step_y
        own, its, both = a.shared(b, step)
        assert np.array_equal(dense(both), moved & other)
        assert np.array_equal(a.holding(both.start - step), own) and np.array_equal(b.holding(both.start), its)


@pytest.mark.parametrize("seed", range(4))
def test_cavities_agree_with_labels_of_every_voxel(seed: int) -> None:
    mask = np.random.default_rng(seed).random((9, 10, 11)) > 0.03 * (seed + 1)
    found = topology(runs_of(mask))
    void, count = label(np.pad(~mask, 1, constant_values=True), np.ones((3, 3, 3)))  # type: ignore[misc]
    inner = np.where(void == void[0, 0, 0], 0, void)[1:-1, 1:-1, 1:-1]
    assert found.cavities == count - 1 and np.array_equal(dense(found.hollow), inner > 0)
    assert sorted(found.cavity_size) == sorted(np.unique(inner[inner > 0], return_counts=True)[1])

"""Light for all corners of tolerances, against the optimum that linear programming finds."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy import sparse
from scipy.optimize import linprog

import vamgpu as vam
from vamgpu.methods.tolerances import Tolerances, at

SIZE, PITCH = 20, 0.1
OFF = Tolerances(axis=0.25 * PITCH, spread=(0.5 * PITCH, PITCH))
PARTS = ("ring", "cross", "bars")


@cache
def projection() -> vam.Projection:
    return vam.Projection(vam.Grid((SIZE, SIZE, 1), PITCH), vam.Beam((30, 1), PITCH), vam.Turntable(30))


def plane() -> tuple[np.ndarray, np.ndarray]:
    x, y = np.meshgrid(*2 * [np.arange(SIZE) - 0.5 * (SIZE - 1)], indexing="ij")
    return x, y


def part(name: str) -> np.ndarray:
    x, y = plane()
    r = np.hypot(x, y)
    return {
        "ring": (r < 7.5) & (r > 3), "cross": ((abs(x) < 3) | (abs(y) < 3)) & (r < 8),
        "bars": (abs(x) < 7) & (abs(y) < 7) & (np.mod(x + 7, 9) < 5),
    }[name]  # fmt: skip


@cache
def entries() -> list[Any]:
    """Dose of every voxel by light of every pixel, at every corner, read off the operators voxel by voxel."""
    found, unit = [], np.zeros((SIZE, SIZE, 1), np.float32)
    for corner in OFF.corners():
        A, rows = at(projection(), corner), []
        for voxel in range(SIZE**2):
            unit[:] = 0.0
            unit.flat[voxel] = 1.0
            rows.append(sparse.csr_matrix(np.asarray(A(unit), np.float64).reshape(1, -1)))
        found.append(sparse.vstack(rows).tocsr())
    return found


@cache
def optimum(name: str) -> float:
    """Greatest a − b of light ≥ 0 whose dose is at least a and at most 1 in the part, at most b outside, everywhere."""
    inside, near = part(name).ravel(), projection().grid.cylinder().ravel()
    unit = max(each.max() for each in entries())
    wanted, void = (sparse.vstack([e[where & near] for e in entries()]) / unit for where in (inside, ~inside))
    ones, none = (lambda k: np.ones((k, 1))), (lambda k: sparse.csr_matrix((k, 1)))
    k, rest = wanted.shape[0], void.shape[0]
    limits = sparse.vstack([
        sparse.hstack([-wanted, ones(k), none(k)]), sparse.hstack([void, none(rest), -ones(rest)]),
        sparse.hstack([wanted, none(k), none(k)]),
    ])  # fmt: skip
    cost = np.zeros(wanted.shape[1] + 2)
    cost[-2:] = -1.0, 1.0
    found = linprog(cost, limits, np.r_[np.zeros(k + rest), np.ones(k)], method="highs").fun
    assert found is not None
    return -found


@pytest.mark.slow
@pytest.mark.parametrize("name", PARTS)
@pytest.mark.parametrize(("method", "iterations", "share"), [("window", 120, 0.75), ("widest", 1000, 0.95)])
def test_it_comes_near_the_optimum_for_all_corners_and_never_beyond(
    name: str, method: str, iterations: int, share: float
) -> None:
    target = part(name)[:, :, None].astype(np.float32)
    plan = vam.optimize(projection(), target, method, iterations, tolerances=OFF)
    top = optimum(name)
    assert share * top < plan.window <= top + 2e-5, plan.window / top
    if method == "widest":
        assert plan.bound is not None and top <= plan.bound.value

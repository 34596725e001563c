"""Ten slices of 40 × 40 voxels and 60 angles, and the widest window of any light for them by linear programming."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.optimize import linprog

import vamgpu

PITCH, ANGLES = 0.1, 60
SIDE, WIDE, APART = 40, 58, 7
"""Voxels across, columns of light, and slices between columns where the matrix is read."""


def slices() -> dict[str, np.ndarray]:
    """Fractions [x, y, 1] of five parts."""
    x, y = np.meshgrid(*2 * [np.arange(SIDE) - 0.5 * (SIDE - 1)], indexing="ij")
    r, t = np.hypot(x, y), np.arctan2(y, x)
    hole = [(np.mod(side + 12, 8) > 3) & (np.mod(side + 12, 8) < 6) for side in (x, y)]
    parts = {
        "ring": (r < 14) & (r > 9),
        "gear": (r < 12 + 2.5 * np.sign(np.cos(8 * t))) & (r > 4),
        "cross": ((abs(x) < 3) | (abs(y) < 3)) & (r < 15),
        "plate with holes": (abs(x) < 12) & (abs(y) < 12) & ~(hole[0] & hole[1]),
        "bars": (abs(x) < 13) & (abs(y) < 13) & (np.mod(x + 13, 5) < 2.6),
    }
    return {name: part[:, :, None].astype(np.float32) for name, part in parts.items()}


def more() -> dict[str, np.ndarray]:
    """Fractions [x, y, 1] of five further parts."""
    x, y = np.meshgrid(*2 * [np.arange(SIDE) - 0.5 * (SIDE - 1)], indexing="ij")
    r, t = np.hypot(x, y), np.arctan2(y, x)
    parts = {
        "star": r < 8 + 5 * np.cos(5 * t),
        "frame": (np.maximum(abs(x), abs(y)) < 12) & (np.maximum(abs(x), abs(y)) > 9),
        "two discs": (np.hypot(x - 6, y) < 5) | (np.hypot(x + 6, y) < 5),
        "comb": (abs(x) < 12) & (abs(y) < 12) & ((y < -6) | (np.mod(x + 12, 6) < 3)),
        "broken ring": (r < 14) & (r > 10) & (abs(t) > 0.6),
    }
    return {name: part[:, :, None].astype(np.float32) for name, part in parts.items()}


def small() -> dict[str, np.ndarray]:
    """Fractions [x, y, 1] of three parts of half the size, with details of 4 voxels and more."""
    x, y = np.meshgrid(*2 * [np.arange(SIDE // 2) - 0.25 * (SIDE - 2)], indexing="ij")
    r = np.hypot(x, y)
    parts = {
        "small ring": (r < 7.5) & (r > 3),
        "small cross": ((abs(x) < 3) | (abs(y) < 3)) & (r < 8),
        "small bars": (abs(x) < 7) & (abs(y) < 7) & (np.mod(x + 7, 9) < 5),
    }
    return {name: part[:, :, None].astype(np.float32) for name, part in parts.items()}


def entries() -> sparse.csr_matrix:
    """Dose of each voxel by light of each pixel, (voxels, pixels)."""
    deep = APART * WIDE
    grid, beam = vamgpu.Grid((SIDE, SIDE, deep), PITCH), vamgpu.Beam((WIDE, deep), PITCH)
    A, columns = vamgpu.Projection(grid, beam, vamgpu.Turntable(ANGLES)), []
    one = vamgpu.Projection(vamgpu.Grid((SIDE, SIDE, 1), PITCH), vamgpu.Beam((WIDE, 1), PITCH), A.motion)
    share = float(one.row_weights[0, 0])  # what a single slice keeps of its row
    for angle in range(ANGLES):
        light = np.zeros(A.range.shape, np.float32)
        light[angle, np.arange(WIDE), APART * np.arange(WIDE) + APART // 2] = share
        dose = np.asarray(A.T(light)).reshape(SIDE, SIDE, WIDE, APART).sum(axis=3, dtype=np.float64)
        columns.append(sparse.csc_matrix(dose.reshape(SIDE**2, WIDE)))
    return sparse.hstack(columns).tocsr()


def optimum(matrix: sparse.csr_matrix, part: np.ndarray, near: np.ndarray) -> float:
    """Greatest a − b of light ≥ 0 whose dose is a to 1 in the part, and at most b elsewhere."""
    inside, void = (matrix[(where & near).ravel()] for where in (part, ~part))
    k, rest, lit = inside.shape[0], void.shape[0], matrix.shape[1]
    limits = sparse.vstack([
        sparse.hstack([-inside, np.ones((k, 1)), np.zeros((k, 1))]),
        sparse.hstack([void, np.zeros((rest, 1)), -np.ones((rest, 1))]),
        sparse.hstack([inside, np.zeros((k, 2))]),
    ]).tocsr()  # fmt: skip
    cost = np.r_[np.zeros(lit), -1.0, 1.0]
    found = linprog(cost, limits, np.r_[np.zeros(k + rest), np.ones(k)], bounds=(0, None), method="highs-ipm")
    assert found.fun is not None, found.message
    return -float(found.fun)

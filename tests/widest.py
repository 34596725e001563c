"""The widest window that any light has, by a linear program over the entries of operators."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse
from scipy.optimize import linprog


def entries_of(A: Any) -> Any:
    """Dose of every voxel by light of every pixel, read off an operator voxel by voxel."""
    unit, rows = np.zeros(A.domain.shape, np.float32), []
    for voxel in range(unit.size):
        unit[:] = 0.0
        unit.flat[voxel] = 1.0
        rows.append(sparse.csr_matrix(np.asarray(A(unit), np.float64).reshape(1, -1)))
    return sparse.vstack(rows).tocsr()


def widest(part: Any, void: Any, brightness: float = np.inf) -> float:
    """Greatest a − b of light from 0 to brightness·(a + b)/2 with a ≤ dose ≤ 1 in the part and dose ≤ b elsewhere."""
    unit = max(part.max(), void.max())
    part, void, n = part / unit, void / unit, part.shape[1]
    one, none = (lambda m: np.ones((m, 1))), (lambda m: sparse.csr_matrix((m, 1)))
    k, rest, half = part.shape[0], void.shape[0], 0.5 * brightness * unit
    rows = [[-part, one(k), none(k)], [void, none(rest), -one(rest)], [part, none(k), none(k)]]
    most = [np.zeros(k + rest), np.ones(k)]
    if np.isfinite(half):
        rows.append([sparse.identity(n), -half * one(n), -half * one(n)])
        most.append(np.zeros(n))
    cost = np.r_[np.zeros(n), -1.0, 1.0]
    found = linprog(cost, sparse.vstack([sparse.hstack(row) for row in rows]), np.concatenate(most), method="highs").fun
    assert found is not None
    return -found

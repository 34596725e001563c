"""Transposes against the entries of the matrix that operators are."""

from __future__ import annotations

from typing import Any

import numpy as np


def transpose_gap(A: Any, most: int = 120, seed: int = 0, matrix: np.ndarray | None = None) -> float:
    """Greatest gap between A.T and the entries of A, over the greatest entry.

    Columns of A are found one by one, of ``most`` entries of its domain at most. A.T is given the light of one pose at
    a time, each pixel with a weight of its own: a wrong entry shows as that weight times itself, 0.5 to 1.5. A matrix
    that is given stands for A, whole.
    """
    rng = np.random.default_rng(seed)
    size = int(np.prod(A.domain.shape))
    chosen = np.sort(rng.permutation(size)[: most if matrix is None else size])
    columns = np.empty((*A.range.shape, len(chosen)))
    unit = np.zeros(A.domain.shape, np.float32)
    for j, k in enumerate(chosen):
        unit.flat[k] = 1.0
        columns[..., j] = np.asarray(A(unit)) if matrix is None else matrix[:, k].reshape(A.range.shape)
        unit.flat[k] = 0.0
    gap, light = 0.0, np.zeros(A.range.shape, np.float32)
    for pose, entries in enumerate(columns):
        light[pose] = rng.uniform(0.5, 1.5, light.shape[1:])
        back = np.asarray(A.T(light)).ravel()[chosen]
        gap = max(gap, float(np.abs(back - np.tensordot(light[pose], entries, entries.ndim - 1)).max()))
        light[pose] = 0.0
    return gap / float(np.abs(columns).max())

"""Errors that voxels have alike."""

from __future__ import annotations

import numpy as np

BLOCK = 8
"""Edge of the blocks of voxels in which errors are compared [voxels]: wider than errors are alike."""

FEWEST = 30.0
"""Fewest voxels of a reconstruction that count as one: its resolution is about three voxels."""


def alike(voxels: np.ndarray, residuals: np.ndarray) -> float:
    """Voxels that err alike, and count as one: how much their blocks err, over what independent ones would.

    voxels: indices (3, voxels).
    """
    _, block = np.unique(voxels // BLOCK, axis=1, return_inverse=True)
    together, apart = np.square(np.bincount(block.ravel(), residuals)).sum(), np.square(residuals).sum()
    return float(max(together / apart, 1.0)) if apart > 0.0 else 1.0


def trends(up: np.ndarray, out: np.ndarray) -> np.ndarray:
    """Errors that all voxels have: everywhere, rising with height, and with the squared radius; (3, voxels)."""
    return np.stack([np.ones_like(up), up, 2.0 * out])

"""The projector's matrix in CSR: row (angle, column), column (x, y), one slice."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp

from vamgpu.kernels.footprint import _lit


def footprint_matrix(n: int, columns: int, poses: np.ndarray, light: dict[str, Any]) -> sp.csr_matrix:
    """(poses·columns, n·n), weights in float64 by the very definition of `back_footprint`, then kept as float32.

    Args:
        n: voxels along x and y.
        columns: of the beam.
        poses: angles [rad].
        light: the numbers and the map of the light that the kernel takes, by name.
    """
    blocks = [_one_pose(n, columns, np.array([np.cos(t), np.sin(t)]), light) for t in poses]
    return sp.vstack(blocks, format="csr", dtype=np.float32)


def _one_pose(n: int, columns: int, direction: np.ndarray, light: dict[str, Any]) -> sp.csr_matrix:
    rows, cells, values = [], [], []
    numbers = (light[name] for name in ("bent", "ratio", "strength", "fill", "sigma", "radius"))
    for column, weight in _lit((n, n, 1), columns, direction, light["light"], *numbers):
        cell = np.flatnonzero(weight)
        rows.append(column.ravel()[cell])
        cells.append(cell)
        values.append(weight.ravel()[cell])
    entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(cells)))
    return sp.csr_matrix(entries, shape=(columns, n * n))


def save_matrix(path: Path, matrix: sp.csr_matrix) -> None:
    """As SciPy saves it, uncompressed."""
    sp.save_npz(path, matrix, compressed=False)

"""The refracting projector's matrix in CSR: row (angle, column), column (x, y), one slice."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import scipy.sparse as sp

from vamgpu.kernels.refract import _lit
from vamgpu.operators.light import Light


def refracted_matrix(n: int, columns: int, poses: np.ndarray, tables: Light) -> sp.csr_matrix:
    """(poses·columns, n·n), weights in float64 by the very definition of `back_refracted`, then kept as float32."""
    blocks = [_one_pose(n, columns, np.array([np.cos(t), np.sin(t)]), tables) for t in poses]
    return sp.vstack(blocks, format="csr", dtype=np.float32)


def _one_pose(n: int, columns: int, direction: np.ndarray, tables: Light) -> sp.csr_matrix:
    rows, cells, values = [], [], []
    for column, weight in _lit((n, n, 1), columns, direction, tables.map, tables.width, tables.radius):
        cell = np.flatnonzero(weight)
        rows.append(column.ravel()[cell])
        cells.append(cell)
        values.append(weight.ravel()[cell])
    entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(cells)))
    return sp.csr_matrix(entries, shape=(columns, n * n))


def save_matrix(path: Path, matrix: sp.csr_matrix) -> None:
    """As SciPy saves it, uncompressed."""
    sp.save_npz(path, matrix, compressed=False)

"""The projector's matrix in CSR: row (angle, column), column (x, y), one slice."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp

from vamgpu.kernels.footprint import _matrix


def footprint_matrix(n: int, columns: int, directions: np.ndarray, light: dict[str, Any]) -> sp.csr_array:
    """(poses·columns, n·n), weights in float64 by the very definition of `back_footprint`, then kept as float32.

    Args:
        n: voxels along x and y.
        columns: of the beam.
        directions: of the poses, as the kernel takes them, (poses, 3).
        light: the numbers and the map of the light that the kernel takes, by name.
    """
    numbers = [light[name] for name in ("bent", "ratio", "strength", "fill", "sigma", "radius")]
    blocks = [_matrix((n, n, 1), columns, direction, light["light"], *numbers) for direction in directions]
    return sp.csr_array(sp.vstack(blocks, format="csr", dtype=np.float32))


def save_matrix(path: Path, matrix: sp.csr_array) -> None:
    """As SciPy saves it, uncompressed."""
    sp.save_npz(path, matrix, compressed=False)

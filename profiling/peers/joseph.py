"""The straight projector's matrix in CSR, from the equations: row (angle, r), column (x, y), one slice.

A ray at angle t and offset r follows r = y cos t - x sin t. Joseph's rule: step along the axis that the ray crosses
fastest, interpolate linearly between the two nearest cells of the other axis, and weigh by the path length of one
step, 1 / max(|cos t|, |sin t|). Lengths are in voxels.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp


def joseph_matrix(n: int, angles: int, bins: int | None = None) -> sp.csr_matrix:
    """Return the (angles*bins, n*n) float32 CSR matrix of one n x n slice over a full turn, weights made in float64.

    Column x*n + y and row angle*bins + r, matching volumes [x, y, z] and sinograms [angle, r, z].
    """
    bins = n if bins is None else bins
    blocks = [_one_angle(n, bins, 2.0 * np.pi * k / angles) for k in range(angles)]
    return sp.vstack(blocks, format="csr", dtype=np.float32)


def _one_angle(n: int, bins: int, t: float) -> sp.csr_matrix:
    c, s = np.cos(t), np.sin(t)
    half = 0.5 * (n - 1)
    r = (np.arange(bins) - 0.5 * (bins - 1))[:, None]
    plane = np.arange(n)[None, :] - half
    # Rays run along (cos t, sin t): where |sin t| wins they step through y and x is interpolated, else the reverse.
    along_y = abs(s) > abs(c)
    across = ((plane * c - r) / s if along_y else (r + plane * s) / c) + half
    lower = np.floor(across)
    weight = across - lower
    lower = lower.astype(np.int64)
    length = 1.0 / max(abs(c), abs(s))
    rows, columns, values = [], [], []
    row, step = np.broadcast_to(np.arange(bins)[:, None], lower.shape), np.broadcast_to(np.arange(n)[None], lower.shape)
    for cell, share in ((lower, 1.0 - weight), (lower + 1, weight)):
        keep = (cell >= 0) & (cell < n) & (share > 0)
        rows.append(row[keep])
        columns.append((cell * n + step if along_y else step * n + cell)[keep])
        values.append((share * length)[keep])
    entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
    return sp.csr_matrix(entries, shape=(bins, n * n))

"""Cubic O-MOMS splines through samples on rings (T. Blu, P. Thévenaz, M. Unser, IEEE Trans. Image Process. 10 (2001)
1069): 4 × 4 coefficients about a point. They are made once, from a table of angular frequencies.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from vamgpu.operators.polar import PolarGrid

TAPS = np.arange(-1, 3)  # number of coefficients about a point that determine the field there
OWN, NEXT = 13 / 21, 4 / 21  # weight of a coefficient in its own sample, and in either next one


def shares(place: np.ndarray) -> list[np.ndarray]:
    """Weight of each of `TAPS` for positions (n,) after the second of them, 0..1; four arrays (n,)."""
    return [_spline(np.abs(place - tap)) for tap in TAPS.tolist()]


def _spline(x: np.ndarray) -> np.ndarray:
    near = 13 / 21 + x * (1 / 14 + x * (x / 2 - 1))
    far = 29 / 21 + x * (x * (1 - x / 6) - 85 / 42)
    return np.where(x < 1.0, near, np.where(x < 2.0, far, 0.0))


def tracks(grid: PolarGrid) -> np.ndarray:
    """`Steps` of the tiles of rings, from the second column but one on: first ring, samples, m, inward, outward, 0."""
    found, before = list[tuple[int, ...]](), dict[int, int]()
    for band in grid.bands:
        for j in range(band.samples):
            m = j if 2 * j < band.samples else j - band.samples
            for tile in band.tiles:
                found.append((tile.begin, band.samples, m, before.get(m, -1)))
                before[m] = len(found) - 1
    inward = np.array(found)
    outward = np.full(len(found), -1)
    outward[inward[inward[:, 3] >= 0, 3]] = np.flatnonzero(inward[:, 3] >= 0)
    return np.column_stack([inward, outward, np.zeros_like(outward)])


def pivots(rings: int) -> np.ndarray:
    """Factors of the elimination along the radius, (rings, 2): across the axis odd waves change their sign."""
    found = np.empty((rings, 2))
    found[0] = OWN + NEXT, OWN - NEXT
    for ring in range(1, rings):
        found[ring] = OWN - NEXT**2 / found[ring - 1]
    found[-1] += NEXT  # as if the last sample continued
    return found

"""Splines through samples on rings: 4 × 4 coefficients about a point give the field there.

Cubic O-MOMS, the piecewise polynomials of maximal order and minimal support that approximate smooth functions best: T.
Blu, P. Thévenaz, M. Unser, IEEE Trans. Image Process. 10 (2001) 1069. Coefficients follow from samples by a division
for each angular frequency and an elimination along the radius. Both are linear and the same at every angle: they are
applied once to a table of angular frequencies, and products then give coefficients instead of samples.
"""

from __future__ import annotations

from concurrent.futures import Executor
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from vamgpu.geometry import FULL_TURN
from vamgpu.kernels.spectrum import ROWS

if TYPE_CHECKING:
    from vamgpu.operators.polar import PolarGrid

TAPS = np.arange(-1, 3)
"""Number of coefficients about a point that determine the field there."""
OWN, NEXT = 13 / 21, 4 / 21
"""Weight of a coefficient in its own sample, and in the next one on either side."""
AT_ONCE = 32
"""Number of frequencies that are filtered together."""


def shares(place: np.ndarray) -> list[np.ndarray]:
    """Weight of each of `TAPS` for positions (n,) after the second of them, 0..1; four arrays (n,)."""
    return [_spline(np.abs(place - tap)) for tap in TAPS.tolist()]


def _spline(x: np.ndarray) -> np.ndarray:
    near = 13 / 21 + x * (1 / 14 + x * (x / 2 - 1))
    far = 29 / 21 + x * (x * (1 - x / 6) - 85 / 42)
    return np.where(x < 1.0, near, np.where(x < 2.0, far, 0.0))


def to_coefficients(entries: np.ndarray, tiles: list[tuple[int, int, int]], grid: PolarGrid, pool: Executor) -> None:
    """Convert entries (frequencies, entries) from samples to coefficients in place; ``pool`` divides frequencies."""
    pivots = _pivots(grid.rings)
    some = [slice(first, first + AT_ONCE) for first in range(0, len(entries), AT_ONCE)]
    tasks = [(part, m, track) for m, track in _tracks(grid).items() for part in some]
    list(pool.map(lambda task: _filter(entries, tiles, grid.angles, pivots, *task), tasks))


def _tracks(grid: PolarGrid) -> dict[int, list[tuple[int, int, int]]]:
    """For each m, outward, tiles of frequencies k + m · angles: number, first ring, samples of a ring in an angle."""
    found: dict[int, list[tuple[int, int, int]]] = {}
    for band in grid.bands:
        for j in range(band.samples):
            track = found.setdefault(j if 2 * j < band.samples else j - band.samples, [])
            first = (band.cell + j * band.rings) // ROWS
            track += [(first + i, tile.begin, band.samples) for i, tile in enumerate(band.tiles)]
    return found


def _pivots(rings: int) -> np.ndarray:
    """Factors of the elimination along the radius, (rings, 2): across the axis, odd waves change their sign."""
    found = np.empty((rings, 2))
    found[0] = OWN + NEXT, OWN - NEXT
    for ring in range(1, rings):
        found[ring] = OWN - NEXT**2 / found[ring - 1]
    found[-1] += NEXT  # as if the last sample continued
    return found


def _filter(
    entries: np.ndarray, tiles: list[tuple[int, int, int]], angles: int, pivots: np.ndarray,
    part: slice, m: int, track: list[tuple[int, int, int]],
) -> None:  # fmt: skip
    """Filter some frequencies of a track: along the radius ring by ring, outward and back, then along the angle."""
    entries = entries[part]
    kappa = np.arange(part.start, part.start + len(entries)) + m * angles
    own = pivots[:, kappa % 2].astype(np.float32)[:, :, None, None]  # (ring, frequency, 1, 1)
    rings: list[tuple[int, np.ndarray]] = []
    for number, first, _ in track:
        tile = of_tile(entries, tiles[number])
        rings += [(first + i, tile[..., i]) for i in range(ROWS)]
    for (inner, before), (_, values) in pairwise(rings):
        columns = min(before.shape[1], values.shape[1])
        values[:, :columns] -= np.float32(NEXT) / own[inner] * before[:, :columns]
    last, values = rings[-1]
    values /= own[last]
    for (_, beyond), (ring, values) in pairwise(reversed(rings)):
        columns = min(beyond.shape[1], values.shape[1])
        values[:, :columns] -= np.float32(NEXT) * beyond[:, :columns]
        values /= own[ring]
    for number, _, samples in track:
        angular = OWN + 2.0 * NEXT * np.cos(FULL_TURN * kappa / (angles * samples))
        of_tile(entries, tiles[number])[...] /= angular.astype(np.float32)[:, None, None, None]


def of_tile(entries: np.ndarray, tile: tuple[int, int, int]) -> np.ndarray:
    """The entries of a tile, (frequency, pair, 2, `ROWS`)."""
    begin, pairs, _ = tile
    return entries[:, begin : begin + 2 * ROWS * pairs].reshape(len(entries), pairs, 2, ROWS)

"""Splines through samples on rings: 4 × 4 coefficients about a place make a field there.

Cubic O-MOMS, the piecewise polynomials of maximal order and minimal support that come nearest to smooth functions:
T. Blu, P. Thévenaz, M. Unser, IEEE Trans. Image Process. 10 (2001) 1069. Coefficients come of samples by a recursive
filter along the angle and one along the radius. Both are linear and the same at every angle: a table of angular
frequencies takes them in once, and products give coefficients where they gave samples.
"""

from __future__ import annotations

from concurrent.futures import Executor
from typing import TYPE_CHECKING

import numpy as np

from vamgpu.geometry import FULL_TURN
from vamgpu.kernels.spectrum import ROWS

if TYPE_CHECKING:
    from vamgpu.operators.polar import PolarGrid

TAPS = np.arange(-1, 3)
"""Coefficients about a place that make what is there."""
OWN, NEXT = 13 / 21, 4 / 21
"""What a coefficient makes of its own sample, and of either next one."""
AT_ONCE = 32
"""Frequencies that are filtered together."""
REACH = 4
"""Columns beyond its own that the coefficients of a tile are kept of; neighboring rings add 0.34 as much for each."""


def shares(place: np.ndarray) -> list[np.ndarray]:
    """What each of `TAPS` is to count for a place after the second of them, 0..1."""
    return [_spline(np.abs(place - tap)) for tap in TAPS.tolist()]


def _spline(x: np.ndarray) -> np.ndarray:
    near = 13 / 21 + x * (1 / 14 + x * (x / 2 - 1))
    far = 29 / 21 + x * (x * (1 - x / 6) - 85 / 42)
    return np.where(x < 1.0, near, np.where(x < 2.0, far, 0.0))


def to_coefficients(entries: np.ndarray, tiles: list[tuple[int, int, int]], grid: PolarGrid, pool: Executor) -> None:
    """Make entries of samples those of coefficients, in place.

    Args:
        entries: (frequencies up to half of the angles, entries), as `vamgpu.kernels.spectrum.Entries`.
        tiles: Of each `ROWS` cells: first entry, pairs of columns, the tile of conjugate entries.
        grid: The rings.
        pool: What works on tiles that do not depend on each other.
    """
    along = [_along_radius(grid.rings, parity) for parity in (1.0, -1.0)]
    some = [slice(first, first + AT_ONCE) for first in range(0, len(entries), AT_ONCE)]
    tasks = [(part, m, track) for m, track in _tracks(grid).items() for part in some]
    list(pool.map(lambda task: _filter(entries, tiles, grid, along, *task), tasks))


def _tracks(grid: PolarGrid) -> dict[int, list[tuple[int, int, int]]]:
    """Of each m the tiles that hold the frequencies k + m · angles, outward: number, first ring, samples of its rings."""
    found: dict[int, list[tuple[int, int, int]]] = {}
    for belt in grid.belts:
        for j in range(belt.samples):
            track = found.setdefault(j if 2 * j < belt.samples else j - belt.samples, [])
            first = (belt.cell + j * belt.rings) // ROWS
            track += [(first + i, tile.begin, belt.samples) for i, tile in enumerate(belt.tiles)]
    return found


def _along_radius(rings: int, parity: float) -> np.ndarray:
    """Coefficients of samples along a diameter on whose other half waves go on (1) or turn about (−1)."""
    values = OWN * np.eye(rings) + NEXT * (np.eye(rings, k=1) + np.eye(rings, k=-1))
    values[0, 0] += parity * NEXT
    values[-1, -1] += NEXT
    return np.linalg.inv(values)


def _filter(
    entries: np.ndarray, tiles: list[tuple[int, int, int]], grid: PolarGrid, along: list[np.ndarray],
    part: slice, m: int, track: list[tuple[int, int, int]],
) -> None:  # fmt: skip
    """Some frequencies of a track; a tile takes samples of its own rings and of those of the tiles beside it."""
    entries = entries[part]
    kappa = np.arange(part.start, part.start + len(entries)) + m * grid.angles

    def of_tile(number: int) -> np.ndarray:
        begin, pairs, _ = tiles[number]
        return entries[:, begin : begin + 2 * ROWS * pairs].reshape(len(entries), pairs, 2, ROWS)

    inner, here = None, of_tile(track[0][0]).copy()  # samples, as they were
    for (number, ring, per_turn), following in zip(track, [*track[1:], None], strict=True):
        outer = None if following is None else of_tile(following[0]).copy()
        own = of_tile(number)
        angular = OWN + 2.0 * NEXT * np.cos(FULL_TURN * kappa / (grid.angles * per_turn))
        for parity, matrix in enumerate(along):
            some = kappa % 2 == parity
            total = np.zeros_like(own[some])
            for samples, first in ((inner, ring - ROWS), (here, ring), (outer, ring + ROWS)):
                if samples is not None:
                    common = min(own.shape[1], samples.shape[1])
                    weights = matrix[ring : ring + ROWS, first : first + ROWS].T.astype(np.float32)
                    total[:, :common] += samples[some, :common] @ weights
            own[some] = total / angular[some, None, None, None].astype(np.float32)
        inner, here = here, outer

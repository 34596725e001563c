"""Energy that straight segments of rays leave in the voxels of the flat film: exact crossings, no steps.

Cut at its point nearest the axis, a segment is monotonic in l and rho: its crossings with walls have closed forms.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import Self

import numpy as np
from numpy.typing import NDArray

from vamgpu.backend.cores import ahead
from vamgpu.optics.inputs import Floats
from vamgpu.optics.roller_rays import Segments
from vamgpu.optics.wrap_map import WrapMap

Reals = NDArray[np.floating]

MOST_CROSSINGS = 1 << 16  # crossings, and voxels, processed at a time: as many as fit a processor's cache
SMALLEST_IMPACT = 1e-12
"""Distance that keeps the angle of a ray through the axis defined [mm]; far below rounding errors."""


@dataclass(frozen=True)
class _Lines:
    """Monotonic segments from ``begin`` to ``finish`` [mm] along lines; ``before``: path in resin before t = 0."""

    column: np.ndarray
    begin: Floats
    finish: Floats
    power: Floats
    before: Floats

    def part(self, rows: np.ndarray | slice) -> Self:
        return type(self)(**{field.name: getattr(self, field.name)[rows] for field in fields(self)})

    def at(self, map: WrapMap, t: Reals) -> tuple[Reals, Reals]:
        """rho and l [mm] at t, (pieces, n)."""
        raise NotImplementedError

    def cross(self, map: WrapMap, rho: Reals, l: Reals) -> tuple[Reals, Reals]:  # noqa: E741 - the web's axis
        """t at which rho and l are reached, (pieces, n); arbitrary if they are not reached."""
        raise NotImplementedError


@dataclass(frozen=True)
class _Arcs(_Lines):
    """Segments on the roller; t counts from the point nearest the axis, at distance ``impact`` and angle ``turn``."""

    impact: Floats
    turn: Floats

    def at(self, map: WrapMap, t: Reals) -> tuple[Reals, Reals]:
        impact = self.impact[:, None]
        phi = np.arctan(t / impact) + self.turn[:, None]
        return np.sqrt(t * t + impact * impact) - map.inner, phi * map.neutral + map.middle

    def cross(self, map: WrapMap, rho: Reals, l: Reals) -> tuple[Reals, Reals]:  # noqa: E741 - the web's axis
        impact, side = self.impact[:, None], np.where(self.finish <= 0, -1.0, 1.0)[:, None]
        phi = (l - map.middle) / map.neutral - self.turn[:, None]
        sunk = side * np.sqrt(np.maximum((map.inner + rho) ** 2 - impact * impact, 0.0))
        return sunk, impact * np.tan(np.clip(phi, -0.5 * np.pi, 0.5 * np.pi))


@dataclass(frozen=True)
class _Straights(_Lines):
    """Segments in a straight run; rho and l at t = 0, and their slopes."""

    depth: Floats
    along: Floats
    fall: Floats
    slope: Floats

    def at(self, map: WrapMap, t: Reals) -> tuple[Reals, Reals]:
        return self.depth[:, None] + t * self.fall[:, None], self.along[:, None] + t * self.slope[:, None]

    def cross(self, map: WrapMap, rho: Reals, l: Reals) -> tuple[Reals, Reals]:  # noqa: E741 - the web's axis
        fall, slope = (np.where(s == 0, np.inf, s)[:, None] for s in (self.fall, self.slope))
        return (rho - self.depth[:, None]) / fall, (l - self.along[:, None]) / slope


def cells(map: WrapMap, segments: Segments, column: np.ndarray, absorption: float, shape: tuple[int, int, int],
          pitch: tuple[float, float]) -> tuple[np.ndarray, np.ndarray, np.ndarray, Floats]:  # fmt: skip
    """Light of columns in voxels: indices column, rho, l, in lexical order, and the sum of their segments.

    A segment leaves power · exp(−α·s)·(1 − exp(−α·Δ)) where it runs from s to s + Δ in a voxel: Beer and Lambert's law
    integrated exactly; without absorption it leaves power · Δ [mm]. column: of each segment. shape: number of columns,
    and of voxels along rho and l. pitch: edges [mm] along rho and l.
    """
    order = np.argsort(column, kind="stable")
    kinds = (_arcs(map, segments, column, order), _straights(map, segments, column, order))
    size = shape[1] * shape[2]
    together = max(1, MOST_CROSSINGS // size)

    def left(first: int) -> tuple[np.ndarray, np.ndarray, Floats]:
        total = np.zeros(min(together, shape[0] - first) * size)
        for lines in kinds:
            low, high = np.searchsorted(lines.column, (first, first + together))
            for some in _chunks(map, lines.part(slice(low, high)), pitch):
                place, weight = _crossed(map, *some, absorption, shape, pitch)
                total += np.bincount(place - first * size, weight, total.size)
        voxel = np.flatnonzero(total)
        return first + voxel // size, voxel % size, total[voxel]

    found = [(np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros(0))]
    found += ahead(left, range(0, shape[0], together))
    row, voxel, weight = (np.concatenate(part) for part in zip(*found, strict=True))
    return row, voxel // shape[2], voxel % shape[2], weight


def _arcs(map: WrapMap, segments: Segments, column: np.ndarray, order: np.ndarray) -> _Arcs:
    """The segments on the roller, cut where they are nearest the axis."""
    rows = order[segments.side[order] == 0]
    x, y, dx, dy = (getattr(segments, name)[rows] for name in ("x", "y", "dx", "dy"))
    start, impact = x * dx + y * dy, x * dy - y * dx
    impact = np.where(np.abs(impact) < SMALLEST_IMPACT, np.copysign(SMALLEST_IMPACT, impact), impact)
    stop = start + segments.length[rows]
    whole = _Arcs(column[rows], start, stop, segments.power[rows], segments.before[rows] - start, impact,
                  np.arctan2(x, -y) - np.arctan(start / impact))  # fmt: skip
    turning = (start < 0) & (stop > 0)
    times = np.where(turning, 2, 1)
    cut = whole.part(np.repeat(np.arange(rows.size), times))
    head = (np.cumsum(times) - times)[turning]
    cut.finish[head], cut.begin[head + 1] = 0.0, 0.0
    return cut


def _straights(map: WrapMap, segments: Segments, column: np.ndarray, order: np.ndarray) -> _Straights:
    """The segments in the straight runs."""
    rows = order[segments.side[order] != 0]
    x, y, dx, dy, side = (getattr(segments, name)[rows] for name in ("x", "y", "dx", "dy", "side"))
    return _Straights(column[rows], np.zeros(rows.size), segments.length[rows], segments.power[rows],
                      segments.before[rows], side * x - map.inner, map.middle + side * (0.5 * map.arc + y),
                      side * dx, side * dy)  # fmt: skip


def _chunks(map: WrapMap, lines: _Lines, pitch: tuple[float, float]
            ) -> Iterator[tuple[_Lines, Reals, Reals]]:  # fmt: skip
    """Groups of segments with similar numbers of walls, and walls [mm] that each may cross along rho and l."""
    if not lines.column.size:
        return
    spans = []
    for value, edge in zip(lines.at(map, np.stack([lines.begin, lines.finish], axis=1)), pitch, strict=True):
        first = np.ceil(value.min(axis=1) / edge)
        spans += [first, np.maximum(np.floor(value.max(axis=1) / edge) - first + 1.0, 0.0)]
    walls = spans[1] + spans[3]
    order = np.argsort(-walls)
    at = 0
    while at < order.size:
        rows = order[at : at + max(1, MOST_CROSSINGS // int(walls[order[at]] + 2))]
        deep, along = (edge * (spans[i][rows, None] + np.arange(int(spans[i + 1][rows].max())))
                       for i, edge in ((0, pitch[0]), (2, pitch[1])))  # fmt: skip
        yield lines.part(rows), deep, along
        at += rows.size


def _crossed(map: WrapMap, lines: _Lines, deep: Reals, along: Reals, absorption: float, shape: tuple[int, int, int],
             pitch: tuple[float, float]) -> tuple[np.ndarray, Reals]:  # fmt: skip
    """Flat indices of the voxels between all walls, and the energy left there; none where two walls coincide."""
    ends = lines.begin[:, None], lines.finish[:, None]
    t = np.concatenate([ends[0], *lines.cross(map, deep, along), ends[1]], axis=1)
    np.clip(t, *ends, out=t)
    t.sort(axis=1)
    rho, l = lines.at(map, 0.5 * (t[:, 1:] + t[:, :-1]))  # noqa: E741 - the web's axis
    layer = np.minimum((rho * (1.0 / pitch[0])).astype(np.int64), shape[1] - 1)
    place = np.minimum((l * (1.0 / pitch[1])).astype(np.int64), shape[2] - 1)
    place += (lines.column[:, None] * shape[1] + np.maximum(layer, 0)) * shape[2]
    if absorption > 0:
        left = lines.power[:, None] * np.exp(-absorption * (lines.before[:, None] + t))
        weight = left[:, :-1] - left[:, 1:]
    else:
        weight = lines.power[:, None] * np.diff(t, axis=1)
    return place.ravel(), weight.ravel()

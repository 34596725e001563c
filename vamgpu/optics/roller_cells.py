"""What straight pieces of rays leave in the voxels of the flat film: exact crossings, no steps.

On the roller the walls of the voxels are circles and radii, in the legs they are planes. Cut at the point nearest the
axis, a piece runs steadily in l and in rho, so that its crossings with the walls are two lists in closed form.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vamgpu.optics.inputs import Floats
from vamgpu.optics.roller_rays import Segments
from vamgpu.optics.wrap_map import WrapMap

Lengths = NDArray[np.floating]

MOST_CROSSINGS = 1 << 20
"""Crossings held at once."""
SMALLEST_IMPACT = 1e-12
"""Keeps the angle of a ray that runs through the axis defined [mm]; far below rounding."""


@dataclass(frozen=True)
class Cells:
    """What each piece of a ray leaves in one voxel. ray: which ray.  rho, l: the voxel.  weight: share of the ray."""

    ray: np.ndarray
    rho: np.ndarray
    l: np.ndarray  # noqa: E741 - the web's axis
    weight: Floats


@dataclass(frozen=True)
class _Lines:
    """Pieces that run steadily. t is counted along the piece's line, from the point nearest the axis on the roller
    (impact, turn: signed distance from the axis and angle φ of that point) and from the start in the legs.
    """

    begin: Floats
    finish: Floats
    curved: np.ndarray
    impact: Floats
    turn: Floats
    along: Floats  # l at t = 0 in a leg
    slope: Floats  # dl/dt in a leg
    depth: Floats  # rho at t = 0 in a leg
    fall: Floats  # drho/dt in a leg
    ray: np.ndarray
    power: Floats
    before: Floats  # way in the resin at t = 0

    def part(self, rows: np.ndarray | slice) -> _Lines:
        return _Lines(**{name: value[rows] for name, value in vars(self).items()})

    def at(self, map: WrapMap, t: Floats) -> tuple[Floats, Floats]:
        """l and rho [mm] at t, (pieces, ...)."""
        c = self.curved[:, None]
        phi = self.turn[:, None] + np.arctan(t / self.impact[:, None])
        l = np.where(c, map.middle + map.neutral * phi, self.along[:, None] + t * self.slope[:, None])  # noqa: E741
        radius = np.sqrt(t * t + (self.impact**2)[:, None]) - map.inner
        return l, np.where(c, radius, self.depth[:, None] + t * self.fall[:, None])

    def cross_l(self, map: WrapMap, l: Lengths) -> Floats:  # noqa: E741 - the web's axis
        """t at which l is reached."""
        phi = (l - map.middle) / map.neutral - self.turn[:, None]
        around = self.impact[:, None] * np.tan(np.clip(phi, -0.5 * np.pi, 0.5 * np.pi))
        slope = np.where(self.slope == 0, np.inf, self.slope)[:, None]
        return np.where(self.curved[:, None], around, (l - self.along[:, None]) / slope)

    def cross_rho(self, map: WrapMap, rho: Lengths) -> Floats:
        """t at which rho is reached."""
        square = (map.inner + rho) ** 2 - (self.impact**2)[:, None]
        side = np.where(self.finish <= 0, -1.0, 1.0)[:, None]
        fall = np.where(self.fall == 0, np.inf, self.fall)[:, None]
        around = side * np.sqrt(np.maximum(square, 0.0))
        return np.where(self.curved[:, None], around, (rho - self.depth[:, None]) / fall)


def cells(map: WrapMap, segments: Segments, absorption: float, shape: tuple[int, int], pitch: tuple[float, float]
          ) -> Cells:
    """Voxels (rho, l) that the pieces cross, and the power each leaves there.

    The weight is power · exp(−α·s)·(1 − exp(−α·Δ)) over the piece from s to s + Δ in a voxel: Beer and Lambert's law
    integrated exactly; without absorption it is power · Δ [mm].  shape, pitch: voxels and edges [mm] along rho and l.
    """
    lines = _lines(map, segments)
    spans = [_span(lines, map, pitch)] if lines.ray.size else []
    found: list[Cells] = []
    for (rows, first_rho, n_rho, first_l, n_l) in (chunk for span in spans for chunk in _chunks(*span)):
        found.append(_crossed(map, lines.part(rows), absorption, shape, pitch, (first_rho, n_rho, first_l, n_l)))
    if not found:
        none = np.zeros(0, dtype=np.int64)
        return Cells(none, none, none, np.zeros(0))
    return Cells(*(np.concatenate([getattr(c, name) for c in found]) for name in ("ray", "rho", "l", "weight")))


def _lines(map: WrapMap, s: Segments) -> _Lines:
    """The segments, cut where they are nearest the axis."""
    curved, from_foot = s.side == 0, s.x * s.dx + s.y * s.dy
    impact = s.x * s.dy - s.y * s.dx
    impact = np.where(np.abs(impact) < SMALLEST_IMPACT, np.copysign(SMALLEST_IMPACT, impact), impact)
    start = np.where(curved, from_foot, 0.0)
    stop = start + s.length
    lines = _Lines(
        begin=start, finish=stop, curved=curved, impact=impact,
        turn=np.arctan2(s.x, -s.y) - np.arctan(from_foot / impact),
        along=map.middle + s.side * (0.5 * map.arc + s.y), slope=s.side * s.dy,
        depth=s.side * s.x - map.inner, fall=s.side * s.dx,
        ray=s.ray, power=s.power, before=s.before - start,
    )  # fmt: skip
    turns = np.flatnonzero(curved & (start < 0) & (stop > 0))
    ends, tails = stop.copy(), lines.part(turns)
    ends[turns] = 0.0
    both = {name: np.concatenate([value, getattr(tails, name)]) for name, value in vars(lines).items()}
    both["begin"] = np.concatenate([start, np.zeros(turns.size)])
    both["finish"] = np.concatenate([ends, stop[turns]])
    return _Lines(**both)


def _span(lines: _Lines, map: WrapMap, pitch: tuple[float, float]) -> tuple[np.ndarray, ...]:
    """First wall inside each piece and number of walls, along rho and along l."""
    l, rho = lines.at(map, np.stack([lines.begin, lines.finish], axis=1))  # noqa: E741
    out: list[np.ndarray] = []
    for value, edge in ((rho, pitch[0]), (l, pitch[1])):
        low, high = np.min(value, axis=1) / edge, np.max(value, axis=1) / edge
        first = np.ceil(low).astype(np.int64)
        out += [first, np.maximum(np.floor(high).astype(np.int64) - first + 1, 0)]
    return tuple(out)


def _chunks(first_rho: np.ndarray, n_rho: np.ndarray, first_l: np.ndarray, n_l: np.ndarray
            ) -> Iterator[tuple[np.ndarray, np.ndarray, int, np.ndarray, int]]:
    """Pieces with about as many walls together, so that little is sorted in vain."""
    order = np.argsort(n_rho + n_l)
    at = 0
    while at < order.size:
        size = max(1, MOST_CROSSINGS // int(n_rho[order[at]] + n_l[order[at]] + 64))
        rows = order[at : at + min(size, max(256, order.size // 8))]
        yield rows, first_rho[rows], int(n_rho[rows].max()), first_l[rows], int(n_l[rows].max())
        at += rows.size


def _crossed(map: WrapMap, lines: _Lines, absorption: float, shape: tuple[int, int], pitch: tuple[float, float],
             walls: tuple[np.ndarray, int, np.ndarray, int]) -> Cells:  # fmt: skip
    first_rho, n_rho, first_l, n_l = walls
    begin, finish = lines.begin[:, None], lines.finish[:, None]
    at_rho = lines.cross_rho(map, pitch[0] * (first_rho[:, None] + np.arange(n_rho)))
    at_l = lines.cross_l(map, pitch[1] * (first_l[:, None] + np.arange(n_l)))
    t = np.sort(np.clip(np.concatenate([begin, at_rho, at_l, finish], axis=1), begin, finish), axis=1)
    t[:, 0], t[:, -1] = lines.begin, lines.finish
    if absorption > 0:
        left = np.exp(-absorption * (lines.before[:, None] + t))
        weight = lines.power[:, None] * (left[:, :-1] - left[:, 1:])
    else:
        weight = lines.power[:, None] * np.diff(t, axis=1)
    row, step = np.nonzero(t[:, 1:] > t[:, :-1])
    middle = 0.5 * (t[row, step] + t[row, step + 1])
    l, rho = (value[:, 0] for value in lines.part(row).at(map, middle[:, None]))  # noqa: E741
    layer = np.clip(np.floor(rho / pitch[0]).astype(np.int64), 0, shape[0] - 1)
    column = np.clip(np.floor(l / pitch[1]).astype(np.int64), 0, shape[1] - 1)
    return Cells(lines.ray[row], layer, column, weight[row, step])

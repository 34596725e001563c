"""Which voxels of a grid have their centers inside a mesh."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from vamgpu.backend.cores import ahead
from vamgpu.metrics.runs import Runs, Shape
from vamgpu.targets.solid import Solid

_NUDGE = np.array([3.1e-7, 1.7e-7])
"""Shift of the columns, in spacings; no column then meets an edge or a corner of a triangle."""
_BATCH = 1 << 18  # number of pairs of a triangle and a column processed at a time


def mesh_runs(solid: Solid, origin: npt.ArrayLike, pitch: float, shape: Shape) -> Runs:
    """The points of a grid inside a closed mesh, by its winding number; overlapping bodies count once."""
    # origin [0, 0, 0] [mm]; pitch [mm]
    corners = (solid.vertices[solid.faces] - np.asarray(origin, np.float64)) / pitch
    corners[..., :2] -= _NUDGE
    low = np.maximum(np.ceil(corners[..., :2].min(axis=1)), 0).astype(np.int64)
    high = np.minimum(np.floor(corners[..., :2].max(axis=1)), np.array(shape[:2]) - 1).astype(np.int64)
    wide = np.maximum(high - low + 1, 0)
    number = wide.prod(axis=1)
    order = np.flatnonzero(number)
    ends = np.searchsorted(number[order].cumsum(), np.arange(_BATCH, number.sum() + _BATCH, _BATCH), side="right")
    pieces = np.split(order, np.unique(ends))
    crossed = ahead(lambda some: _crossed(corners, some, low, wide, number, shape[2]), pieces)
    x, y, above, sign = (np.concatenate(each) for each in zip(*crossed, strict=True))
    column = x * (shape[1] + 1) + y
    place = column * (shape[2] + 1) + above
    order = np.argsort(place, kind="stable")
    place, column, turns = place[order], column[order], sign[order].cumsum()
    # A triangle that faces up closes the solid: points below it are inside.
    inside = turns[np.searchsorted(column, column, "right") - 1] > turns
    last = np.append(place[1:] != place[:-1], True)[: len(place)]
    place, inside = place[last], inside[last]
    before = np.append(False, inside[:-1])[: len(place)]
    return Runs(shape, place[inside & ~before], place[before & ~inside])


def _crossed(
    corners: np.ndarray, some: np.ndarray, low: np.ndarray, wide: np.ndarray, number: np.ndarray, top: int
) -> tuple[np.ndarray, ...]:
    """Crossings of columns x, y and triangles: the first grid point above, and +1 for upward faces, else −1."""
    face = np.repeat(some, number[some])
    step = np.arange(len(face)) - np.repeat(number[some].cumsum() - number[some], number[some])
    x, y = low[face, 0] + step // wide[face, 1], low[face, 1] + step % wide[face, 1]
    a, b, c = np.moveaxis(corners[face], 1, 0)
    weights = np.stack([_turn(q, r, x, y) for q, r in ((b, c), (c, a), (a, b))])
    hit = (weights > 0).all(axis=0) | (weights < 0).all(axis=0)
    x, y, weights = x[hit], y[hit], weights[:, hit]
    total = weights.sum(axis=0)
    z = (weights[0] * a[hit, 2] + weights[1] * b[hit, 2] + weights[2] * c[hit, 2]) / total
    return x, y, np.clip(np.ceil(z), 0, top).astype(np.int64), np.sign(total).astype(np.int16)


def _turn(p: np.ndarray, q: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Twice the area of the triangle of two corners and a column, seen from above; > 0 counter-clockwise."""
    # Computed from the same end in both directions of the edge; neighboring triangles then agree.
    swap = (p[:, 0] > q[:, 0]) | ((p[:, 0] == q[:, 0]) & (p[:, 1] > q[:, 1]))
    one, other = np.where(swap[:, None], q, p), np.where(swap[:, None], p, q)
    area = (one[:, 0] - x) * (other[:, 1] - y) - (one[:, 1] - y) * (other[:, 0] - x)
    return np.where(swap, -area, area)

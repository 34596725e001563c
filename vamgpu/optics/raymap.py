"""The inverse ray map: which column of the beam lights a point of the resin."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from vamgpu.backend.cores import pointwise
from vamgpu.optics.faces import Face, turn
from vamgpu.optics.inputs import Floats

NODES, FEW_NODES = 64, 8  # of the scan that brackets the first root, and of one for points that one ray reaches
CHUNK = 2048  # points at once, so that the scan stays in the cache
STEP_DONE = 1e-8  # Newton doubles the digits: a step of this size leaves an error near rounding
MOST_STEPS = 100


def first_columns(faces: Sequence[Face], aperture: float, ratio: float, x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Column u [mm] of the ray through each (x, y) [mm], and dX_perpendicular/du of that ray; 0 without a ray."""
    # The ray of column u passes (X, Y) where f(u) = X cos d(u) + Y sin d(u) − ratio·u vanishes. f(0) = X, and mirroring
    # X mirrors u: the ray is the first change of sign over 0 < u < aperture, for |X|. Newton's method runs in ψ with u
    # = aperture·sin ψ, in which d is smooth up to the last ray.
    u, spacing = np.empty_like(x), np.empty_like(x)
    single = x**2 + y**2 < (ratio * aperture) ** 2
    for some, nodes in ((single, FEW_NODES), (~single, NODES)):
        found = pointwise(partial(_piece, faces, aperture, ratio, nodes), np.abs(x[some]), y[some])
        u[some], spacing[some] = found
    return np.copysign(u, x), spacing


def _piece(
    faces: Sequence[Face], aperture: float, ratio: float, nodes: int, x: Floats, y: Floats
) -> tuple[Floats, Floats]:  # fmt: skip
    psi = np.linspace(0.0, 0.5 * np.pi, nodes + 1)
    columns = aperture * np.sin(psi)
    cos_d, sin_d, _ = turn(faces, columns)
    node, before, after = np.empty(x.size, np.int64), np.empty_like(x), np.empty_like(x)
    for start in range(0, x.size, CHUNK):
        some = slice(start, start + CHUNK)
        # avoid BLAS, whose threads would compete with ours
        values = x[some, None] * cos_d + (y[some, None] * sin_d - ratio * columns)
        node[some] = at = np.argmax(values[:, 1:] <= 0.0, axis=1)
        row = np.arange(at.size)
        before[some], after[some] = values[row, at], values[row, at + 1]
    lit = np.flatnonzero(after <= 0.0)
    node, before, after = node[lit], before[lit], after[lit]
    fraction = before / np.maximum(before - after, np.finfo(np.float64).tiny)
    start = psi[node] + (psi[1] - psi[0]) * fraction
    root = _newton(faces, aperture, ratio, x[lit], y[lit], psi[node], psi[node + 1], start)
    u, spacing = np.full_like(x, aperture), np.zeros_like(x)
    u[lit] = aperture * np.sin(root)
    cos_d, sin_d, slope = turn(faces, u[lit])
    spacing[lit] = ratio - (y[lit] * cos_d - x[lit] * sin_d) * slope
    return u, spacing


def _newton(
    faces: Sequence[Face], aperture: float, ratio: float, x: Floats, y: Floats, low: Floats, high: Floats, psi: Floats
) -> Floats:
    """Root of f in psi between low (f >= 0) and high (f <= 0), by Newton's method safeguarded by bisection."""
    root = psi.copy()
    live = np.arange(x.size)
    for _ in range(MOST_STEPS):
        u = aperture * np.sin(psi)
        cos_d, sin_d, slope = turn(faces, u)
        value = x * cos_d + y * sin_d - ratio * u
        low, high = np.where(value >= 0.0, psi, low), np.where(value >= 0.0, high, psi)
        gradient = ((y * cos_d - x * sin_d) * slope - ratio) * (aperture * np.cos(psi))
        gradient = np.where(gradient == 0.0, np.finfo(np.float64).tiny, gradient)
        with np.errstate(over="ignore"):
            following = psi - value / gradient
        outside = (following < low) | (following > high) | ~np.isfinite(following)
        following = np.where(outside, 0.5 * (low + high), following)
        moving = np.abs(following - psi) > STEP_DONE
        root[live] = following
        if not moving.any():
            break
        live, x, y, psi = live[moving], x[moving], y[moving], following[moving]
        low, high = low[moving], high[moving]
    return root

"""Dual variables of a dose, raised until no pixel gains: a certificate that no light has a wider process window."""

from __future__ import annotations

import numpy as np

from vamgpu.kernels.pointwise import Parts, keep_most, near_axis, pointwise
from vamgpu.kernels.signature import Array, ArrayInOut, ArrayOut, Real

FAINT = 1e-9
"""Least light of an infeasible pixel."""
NEVER = 1e30
"""Scale of a cover that does not reach such a pixel."""


@pointwise(over="lower")
def divide_prices(
    lower: Array, upper: Array, target: Array, inside: Real, outside: Real, paid: ArrayOut, cost: ArrayOut
) -> None:
    """paid = inside·lower in the part, 0 outside; cost = inside·upper in the part, outside·lower outside."""
    # Dual variables below 0 count as 0; see `vamgpu.kernels.pdhg.dual_step` for lower and upper.
    part = target >= 0.5
    paid[...] = np.where(part, inside * np.maximum(lower, 0.0), 0.0)
    cost[...] = np.where(part, inside * np.maximum(upper, 0.0), outside * np.maximum(lower, 0.0))


@pointwise(over="light")
def light_short_pixels(paid: Array, cost: Array, cover: Array, scale: Real, light: ArrayInOut) -> None:
    """light = max(FAINT, light·(short / (scale·cover))²) where short = paid − cost > 0, else 0; 1 where cover is 0."""
    short, reached = paid - cost, cover > 0.0
    grown = light * (np.maximum(short, 0.0) / np.where(reached, scale * cover, 1.0)) ** 2
    light[...] = np.where(short > 0.0, np.where(reached, np.clip(grown, FAINT, 1.0), 1.0), 0.0)


@pointwise(over="cover")
def level_cover(rows: Array, reach: Real, cover: ArrayInOut) -> None:
    """cover = cover / rows within ``reach`` samples of the axis where rows > 0, else 0."""
    near = near_axis(cover, reach) & (rows > 0)
    cover[...] = np.where(near, cover / np.where(near, rows, 1.0), 0.0)


@pointwise(over="paid")
def cover_scale(paid: Array, cost: Array, cover: Array, keep: Real, highs: Parts) -> None:
    """max highs = greatest (keep·paid − cost) / cover over pixels where it is > 0; NEVER where cover is 0."""
    short, reached = keep * paid - cost, cover > 0.0
    scales = np.where(short > 0.0, np.where(reached, short / np.where(reached, cover, 1.0), NEVER), 0.0)
    keep_most(highs, scales)

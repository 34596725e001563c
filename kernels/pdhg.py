"""Steps of PDHG on the window's linear program; see `vamgpu.methods.pdhg`."""

from __future__ import annotations

import numpy as np

from vamgpu.kernels.pointwise import Parts, add_up, near_axis, pointwise
from vamgpu.kernels.signature import Array, ArrayInOut, ArrayOut, Real


@pointwise(over="light")
def primal_step(
    light: Array, columns: Array, step: Real, most: Real, ahead: ArrayInOut, after: ArrayOut, moved: Parts
) -> None:
    """after = light − step·ahead / columns, clipped to 0…most, 0 where columns are 0; then ahead = 2·after − light."""
    # ahead: direction of descent. columns: sums of pixels' entries in all limits. Σ moved = Σ columns·(after − light)².
    lit = columns > 0
    after[...] = np.where(lit, np.clip(light - step * ahead / np.where(lit, columns, 1.0), 0.0, most), 0.0)
    ahead[...] = 2.0 * after - light
    add_up(moved, columns * (after - light) ** 2)


@pointwise(over="lower")
def dual_step(
    ahead: Array, held: Array, target: Array, rows: Array, least: Real, leak: Real, step: Real, reach: Real,
    lower: Array, upper: Array, lower_after: ArrayOut, upper_after: ArrayOut, inside: Parts, outside: Parts,
    moved: Parts, crossed: Parts,
) -> None:  # fmt: skip
    """Multipliers of a dose: ``lower`` of ≥ least inside and ≤ leak outside, ``upper`` of ≤ 1 inside."""
    # rows: dose of light 1 everywhere. Σ inside, Σ outside: of ``lower`` after, on either side. Σ moved: of squared
    # changes times the divisors of the steps. Σ crossed: of the change of `dual_dose` times half of ahead − held.
    near = near_axis(target, reach) & (rows > 0)
    part, weight = target >= 0.5, np.where(near, rows, 1.0)
    excess = np.where(part, least - ahead, ahead - leak)
    lower_after[...] = np.where(near, np.maximum(0.0, lower + step * excess / (weight + 1.0)), 0.0)
    upper_after[...] = np.where(near & part, np.maximum(0.0, upper + step * (ahead - 1.0) / weight), 0.0)
    higher, tighter = lower_after - lower, upper_after - upper
    add_up(inside, np.where(part, lower_after, 0.0))
    add_up(outside, np.where(part, 0.0, lower_after))
    add_up(moved, (weight + 1.0) * higher**2 + weight * tighter**2)
    add_up(crossed, np.where(part, tighter - higher, higher) * (0.5 * (ahead - held)))


@pointwise(over="pull")
def dual_dose(lower: Array, upper: Array, target: Array, pull: ArrayOut) -> None:
    """pull = cost of a unit of dose: ``lower`` outside, upper − lower inside."""
    pull[...] = np.where(target >= 0.5, upper - lower, lower)

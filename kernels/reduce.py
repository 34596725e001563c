"""Sums, products and extremes of fields: one partial result per work item, folded to at most a few hundred."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from vamgpu.kernels.pointwise import Parts, add_up, keep_least, keep_most, near_axis, pointwise
from vamgpu.kernels.signature import Array, Integer, Real, Table, kernel

Partial = Annotated[np.ndarray, Table("float32", ("part",))]
Folded = Annotated[np.ndarray, Table("float32", ("folded",), writes=True)]

SUM, LOW, HIGH = 0, 1, 2


@pointwise(over="a")
def partial_sum(a: Array, parts: Parts) -> None:
    """Σ parts = Σ a."""
    add_up(parts, a)


@pointwise(over="a")
def partial_dot(a: Array, b: Array, parts: Parts) -> None:
    """Σ parts = Σ a·b."""
    add_up(parts, a * b)


@pointwise(over="a")
def partial_extent(a: Array, mask: Array, lower: Real, upper: Real, reach: Real, lows: Parts, highs: Parts) -> None:
    """min lows and max highs = extremes of a where lower ≤ mask < upper, at most ``reach`` samples from the z axis."""
    # Items without such a sample leave ±infinity.
    chosen = (mask >= lower) & (mask < upper) & near_axis(a, reach)
    keep_least(lows, np.where(chosen, a, np.inf))
    keep_most(highs, np.where(chosen, a, -np.inf))


@kernel(over="folded", reach="part")
def fold(parts: Partial, kind: Integer, folded: Folded) -> None:
    """folded[k] = sum (kind 0), minimum (1) or maximum (2) of parts[k], parts[k + n], … with n the length of folded."""
    combine = (np.add, np.minimum, np.maximum)[kind]
    identity = (0.0, np.inf, -np.inf)[kind]
    for k in range(len(folded)):
        folded[k] = combine.reduce(parts[k :: len(folded)], initial=identity)

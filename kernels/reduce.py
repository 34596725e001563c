"""Sums, products and extremes of fields: one partial result per work item, folded to at most a few hundred.

Partial results are float32 of short runs; the host adds the last few hundred in float64.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np

from vamgpu.kernels.signature import Array, Integer, Real, Table, Tiling, kernel

Parts = Annotated[np.ndarray, Table("float32", ("part",), writes=True)]
Partial = Annotated[np.ndarray, Table("float32", ("part",))]
Folded = Annotated[np.ndarray, Table("float32", ("folded",), writes=True)]
CPU = Tiling(major=1, minor=0)
GPU = Tiling(major=32, minor=1)

SUM, LOW, HIGH = 0, 1, 2


def disc(n_i: int, n_j: int, reach: float) -> np.ndarray:
    """Boolean (n_i, n_j): samples at most ``reach`` samples from the middle."""
    i, j = (np.arange(n) - 0.5 * (n - 1) for n in (n_i, n_j))
    return i[:, None] ** 2 + j[None, :] ** 2 <= reach**2


@kernel(over="a", cpu=CPU, gpu=GPU)
def partial_sum(a: Array, parts: Parts) -> None:
    """Σ parts = Σ a."""
    parts[...] = 0.0
    parts[0] = a.sum()


@kernel(over="a", cpu=CPU, gpu=GPU)
def partial_dot(a: Array, b: Array, parts: Parts) -> None:
    """Σ parts = Σ a·b."""
    parts[...] = 0.0
    parts[0] = np.vdot(a, b)


@kernel(over="a", cpu=CPU, gpu=GPU)
def partial_extent(a: Array, mask: Array, lower: Real, upper: Real, reach: Real, lows: Parts, highs: Parts) -> None:
    """min lows and max highs = extremes of a where lower ≤ mask < upper, at most ``reach`` samples from the z axis.

    Items without such a sample leave ±infinity.
    """
    chosen = (mask >= lower) & (mask < upper) & disc(a.shape[0], a.shape[1], reach)[:, :, None]
    lows[...], highs[...] = np.inf, -np.inf
    lows[0] = a.min(where=chosen, initial=np.inf)
    highs[0] = a.max(where=chosen, initial=-np.inf)


@kernel(over="folded", reach="part")
def fold(parts: Partial, kind: Integer, folded: Folded) -> None:
    """folded[k] = sum (kind 0), minimum (1) or maximum (2) of parts[k], parts[k + n], … with n the length of folded."""
    combine = (np.add, np.minimum, np.maximum)[kind]
    identity = (0.0, np.inf, -np.inf)[kind]
    for k in range(len(folded)):
        folded[k] = combine.reduce(parts[k :: len(folded)], initial=identity)

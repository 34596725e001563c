"""Histograms and extremes of a field, split into two classes by a second field, for the whole or slice by slice."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from vamgpu.kernels.pointwise import near_axis
from vamgpu.kernels.signature import Array, Real, Table, Tiling, kernel

Ranges = Annotated[np.ndarray, Table("float32", ("slice", "2", "3"))]
"""Low, high, bins per unit of each class; one slice for all, or one per slice."""
Partial = Annotated[np.ndarray, Table("uint32", ("strip", "z", "2", "bin"))]
PartialOut = Annotated[np.ndarray, Table("uint32", ("strip", "z", "2", "bin"), writes=True)]
CountsOut = Annotated[np.ndarray, Table("uint32", ("slice", "2", "bin"), writes=True)]
Parts = Annotated[np.ndarray, Table("float32", ("strip", "z", "2", "3"))]  # least, greatest, sum
PartsOut = Annotated[np.ndarray, Table("float32", ("strip", "z", "2", "3"), writes=True)]
StatisticsOut = Annotated[np.ndarray, Table("float32", ("slice", "2", "3"), writes=True)]

NO_CLASS = -1e12
"""Samples whose target lies below this belong to neither class."""

ROWS = Tiling(major=16, minor=0, group=(8, 8))
GPU_ROWS = 8
GPU = Tiling(major=GPU_ROWS, minor=0, group=(8, 8))


def _members(target: np.ndarray, level: float, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Boolean [i, j, z] of the two classes."""
    counted = near_axis(target, radius)
    return counted & ~(target >= level) & (target >= NO_CLASS), counted & (target >= level)


@kernel(over="dose", cpu=ROWS, gpu=GPU)
def tally(dose: Array, target: Array, ranges: Ranges, level: Real, radius: Real, partial: PartialOut) -> None:
    """partial[·, z, class, bin] counts dose: bin 0 is below low, the last at or above high, the others even between."""
    partial[...] = 0
    bins = partial.shape[3]
    for which, member in enumerate(_members(target, level, radius)):
        low, high, scale = (ranges[:, which, k] for k in range(3))
        index = 1 + np.clip(((dose - low) * scale).astype(int), 0, max(bins - 3, 0))
        index = np.where(dose < low, 0, np.where(dose >= high, bins - 1, index))
        for z in range(dose.shape[2]):
            partial[0, z, which] = np.bincount(index[:, :, z][member[:, :, z]], minlength=bins)


@kernel(over="counts")
def fold_counts(partial: Partial, counts: CountsOut) -> None:
    """counts[slice] = Σ partial over strips, and over all z if there is only one slice."""
    each = partial.sum(axis=0)
    counts[...] = each if counts.shape[0] == each.shape[0] else each.sum(axis=0)


@kernel(over="dose", cpu=ROWS, gpu=GPU)
def survey(dose: Array, target: Array, level: Real, radius: Real, parts: PartsOut) -> None:
    """parts[·, z, class] = least, greatest and sum of dose; +∞, −∞, 0 for an empty class."""
    parts[...] = np.array([np.inf, -np.inf, 0.0])
    for which, member in enumerate(_members(target, level, radius)):
        for z in range(dose.shape[2]):
            values = dose[:, :, z][member[:, :, z]]
            if values.size:
                parts[0, z, which] = values.min(), values.max(), values.sum()


@kernel(over="statistics")
def fold_survey(parts: Parts, statistics: StatisticsOut) -> None:
    """statistics[slice, class] = least, greatest and sum over strips, and over all z if there is only one slice."""
    axes = (0,) if statistics.shape[0] == parts.shape[1] else (0, 1)
    statistics[..., 0] = parts[..., 0].min(axis=axes)
    statistics[..., 1] = parts[..., 1].max(axis=axes)
    statistics[..., 2] = parts[..., 2].sum(axis=axes)

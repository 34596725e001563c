"""Counts, extremes and exact order statistics of the two classes, for the whole volume or for each slice."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.kernels.histogram import fold_counts, fold_survey, survey, tally
from vamgpu.metrics.parts import Parts

BINS = 512  # number of bins of a search: both classes of the whole volume then need a transfer of 4 kB

PASSES = 4  # each pass divides the range by 510; after four passes the range is below the resolution of float32


@dataclass(frozen=True, eq=False)
class Extremes:
    """Least, greatest and sum of each class, arrays [slice, class]; +∞, −∞ and 0 for empty classes."""

    least: np.ndarray
    greatest: np.ndarray
    total: np.ndarray


@dataclass(frozen=True, eq=False)
class Histogram:
    """Voxels of each class per bin of dose."""

    edges: np.ndarray  # (bins + 1,) in units of the dose
    counts: np.ndarray  # int64 [slice, class, bin], class 0 outside and class 1 inside the part


def extremes(parts: Parts, *, per_slice: bool = False) -> Extremes:
    """Exact extremes and sums of the dose of each class, for the whole (one slice) or for every z."""
    device, nz = parts.dose.device, parts.dose.shape[2]
    partial = device.empty((_strips(parts), nz, 2, 3), device.kept("float32"), table=True)
    folded = device.empty((nz if per_slice else 1, 2, 3), device.kept("float32"), table=True)
    device.launch(survey, dose=parts.dose, target=parts.target, level=parts.level, radius=parts.reach, parts=partial)
    device.launch(fold_survey, parts=partial, statistics=folded)
    values = folded.numpy().astype(np.float64)
    return Extremes(values[..., 0], values[..., 1], values[..., 2])


def histogram(parts: Parts, bins: int = 256, *, top: float | None = None, per_slice: bool = False) -> Histogram:
    """Counts of ``bins`` even bins from 0 to ``top`` (the greatest dose by default); doses beyond join the end bins."""
    high = float(extremes(parts).greatest.max()) if top is None else top
    counts = tallied(parts, np.array([0.0, 0.0]), np.array([high, high]), bins + 2, per_slice=per_slice)
    counts[..., 1] += counts[..., 0]
    counts[..., -2] += counts[..., -1]
    return Histogram(np.linspace(0.0, high, bins + 1), counts[..., 1:-1])


def above(parts: Parts, threshold: float, *, per_slice: bool = False) -> np.ndarray:
    """Voxels of each class with a dose below and at or above a threshold: int64 [slice, class, 2], exact."""
    at = np.full(2, threshold)
    return tallied(parts, at, at, 2, per_slice=per_slice)


def order_statistic(parts: Parts, rank: np.ndarray, *, per_slice: bool = False) -> np.ndarray:
    """Dose of the voxel of each class with ``rank`` smaller ones: [slice, class], to float32; NaN in empty classes."""
    # rank: [slice, class], from 0.
    ends = extremes(parts, per_slice=per_slice)
    full = np.isfinite(ends.least)
    low, high = np.where(full, ends.least, 0.0), np.where(full, ends.greatest, 0.0)
    for _ in range(PASSES):
        counts = tallied(parts, low, high, BINS, per_slice=per_slice)
        at = np.argmax(counts.cumsum(axis=-1) > rank[..., None], axis=-1)
        width = (high - low) / (BINS - 2)
        start = np.where(at == 0, low, np.where(at == BINS - 1, high, low + (at - 1) * width))
        stop = np.where(at == 0, low, np.where(at == BINS - 1, high, low + at * width))
        low, high = start, stop
    return np.where(full, 0.5 * (low + high), np.nan)


def tallied(parts: Parts, low: np.ndarray, high: np.ndarray, bins: int, *, per_slice: bool = False) -> np.ndarray:
    """Counts int64 [slice, class, bins]: below low, even bins, at or above high; low, high: [(slice,) class]."""
    device, nz = parts.dose.device, parts.dose.shape[2]
    slices = nz if per_slice else 1
    span = np.asarray(high, np.float64) - low
    scale = np.divide(bins - 2, span, out=np.zeros_like(span), where=span > 0)
    ranges = np.broadcast_to(np.stack([low, high, np.minimum(scale, 1e30)], axis=-1), (slices, 2, 3))
    partial = device.empty((_strips(parts), nz, 2, bins), "uint32", table=True)
    counts = device.empty((slices, 2, bins), "uint32", table=True)
    table: DeviceArray = device.table(np.ascontiguousarray(ranges))
    fields = {"dose": parts.dose, "target": parts.target, "level": parts.level, "radius": parts.reach}
    device.launch(tally, **fields, ranges=table, partial=partial)
    device.launch(fold_counts, partial=partial, counts=counts)
    return counts.numpy().astype(np.int64)


def _strips(parts: Parts) -> int:
    """Number of strips of rows into which the kernels divide a slice."""
    return parts.dose.device.items(tally, (parts.dose.shape[0], 1, 1))

"""The threshold that prints a dose best, and what it gets wrong."""

from __future__ import annotations

import numpy as np

from vamgpu.metrics.histogram import BINS, Extremes, tallied
from vamgpu.metrics.parts import IN, OUT, Parts

PASSES = 8
"""Passes at most; each divides what is left of the range by up to 510."""


def best_threshold(parts: Parts, ends: Extremes, voxels: tuple[int, int]) -> float:
    """The dose from which a voxel should count as printed for the greatest intersection over union with the part.

    Midway between part and rest where they are apart. Elsewhere the doses both have are searched: each pass looks
    closer at the bins inside which the intersection over union could still rise. A float32 number.
    """
    least, greatest = float(ends.least[0, IN]), float(ends.greatest[0, OUT])
    if least > greatest:
        return _between(max(greatest, 0.0), least)
    low, high = least, float(np.nextafter(np.float32(greatest), np.float32(np.inf)))
    best, found = least, -1.0
    for _ in range(PASSES):
        edges = np.linspace(low, high, BINS - 1)
        reached = tallied(parts, np.full(2, low), np.full(2, high), BINS)[0, :, ::-1].cumsum(axis=1)[:, ::-1][:, 1:]
        ious = reached[IN] / np.maximum(voxels[IN] + reached[OUT], 1)
        if ious.max() > found:
            found = float(ious.max())
            best = float(np.median(edges[_longest_run(ious == found)]))
        bound = reached[IN, :-1] / np.maximum(voxels[IN] + reached[OUT, 1:], 1)
        open_bins = np.flatnonzero(bound > found)
        if not open_bins.size:
            break
        low, high = float(edges[open_bins[0]]), float(edges[open_bins[-1] + 1])
    return float(np.float32(best))


def _between(low: float, high: float) -> float:
    """A float32 number above low and at most high, midway if there is one."""
    middle = float(np.float32(0.5 * (low + high)))
    return middle if low < middle <= high else high


def _longest_run(chosen: np.ndarray) -> np.ndarray:
    """Indices of the longest run of True."""
    index = np.flatnonzero(chosen)
    return max(np.split(index, np.flatnonzero(np.diff(index) > 1) + 1), key=len)

"""All scores of a print, over the whole volume."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.errors import BadInput
from vamgpu.metrics.histogram import BINS, Extremes, above, extremes, tallied
from vamgpu.metrics.parts import IN, OUT, Parts
from vamgpu.metrics.window import Windows, windows

PASSES = 8  # greatest number of passes; each divides the remaining range by up to 510


@dataclass(frozen=True)
class Scores:
    """Scores of a dose against a target, at one threshold.

    Args:
        windows: Process windows over ``peak``.
        threshold: Dose from which a voxel counts as printed, chosen for the best ``iou``.
        iou: Ratio of the intersection of part and print to their union.
        error_rate: VER, judged voxels on the wrong side of that threshold over all.
        overlap_rate: Voxels outside the part with at least the least dose in it, over all (C. Rackson et al., Addit.
            Manuf. 48 (2021) 102367).
        dose_range: IPDR, greatest − least dose in the part over ``peak``.
        least_in, greatest_in, greatest_out, peak: Least and greatest dose in the part, greatest outside, and greatest
            of all.
        total_in: Σ dose over the part.
        in_voxels, out_voxels: Numbers of judged voxels.
        missing: Number of voxels in the part that are not printed.
        excess: Number of printed voxels outside the part.
    """

    windows: Windows
    threshold: float
    iou: float
    error_rate: float
    overlap_rate: float
    dose_range: float
    least_in: float
    greatest_in: float
    greatest_out: float
    peak: float
    total_in: float
    in_voxels: int
    out_voxels: int
    missing: int
    excess: int

    @property
    def window(self) -> float:
        """The strict process window."""
        return self.windows.strict


def score(dose: DeviceArray, target: DeviceArray, *, threshold: float | None = None) -> Scores:
    """Judge a dose by a target.

    Args:
        dose: Dose [x, y, z] on a device.
        target: Fractions [x, y, z] on the same device.
        threshold: Dose from which a voxel counts as printed; the best one by default.

    Returns:
        The scores.

    Raises:
        BadInput: The target has no voxel in the cylinder.
    """
    parts = Parts(dose, target)
    ends = extremes(parts)
    counts = _voxels(parts)
    at = float(np.float32(best_threshold(parts, ends, counts) if threshold is None else threshold))
    (_, excess), (missing, printed) = above(parts, at)[0].tolist()
    least, greatest = float(ends.least[0, IN]), float(ends.greatest[0, IN])
    above_least = int(above(parts, least)[0, OUT, 1])
    peak = float(ends.greatest.max())
    return Scores(
        windows=windows(parts, ends, counts),
        threshold=at,
        iou=printed / (counts[IN] + excess),
        error_rate=(missing + excess) / sum(counts),
        overlap_rate=above_least / sum(counts),
        dose_range=(greatest - least) / (peak or 1.0),
        least_in=least,
        greatest_in=greatest,
        greatest_out=max(float(ends.greatest[0, OUT]), 0.0),
        peak=peak,
        total_in=float(ends.total[0, IN]),
        in_voxels=counts[IN],
        out_voxels=counts[OUT],
        missing=missing,
        excess=excess,
    )


def _voxels(parts: Parts) -> tuple[int, int]:
    """Judged voxels outside and in the part; `BadInput` if none is in it."""
    found = above(parts, 0.0)[0].sum(axis=1)
    if not found[IN]:
        raise BadInput(
            f"no voxel within {parts.reach:g} voxels of the axis is in the part (fraction ≥ {parts.level:g}); "
            "center the target on the axis or use a finer pitch"
        )
    return int(found[OUT]), int(found[IN])


def best_threshold(parts: Parts, ends: Extremes, voxels: tuple[int, int]) -> float:
    """The threshold with the greatest intersection over union of print and part, a float32 number."""
    # If the doses of part and void do not overlap, it is midway between them. Otherwise the overlapping range of doses
    # is searched: each pass refines the bins inside which the intersection over union could still rise. No threshold
    # prints a voxel without light.
    least, greatest = float(ends.least[0, IN]), float(ends.greatest[0, OUT])
    least = least if least > 0.0 else float(ends.greatest.max()) / BINS
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
            index = np.flatnonzero(ious == found)
            longest = max(np.split(index, np.flatnonzero(np.diff(index) > 1) + 1), key=len)
            best = float(np.median(edges[longest]))
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

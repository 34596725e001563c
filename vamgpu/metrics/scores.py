"""Every number a print is judged by, over the whole volume."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.errors import BadInput
from vamgpu.metrics.histogram import above, extremes
from vamgpu.metrics.overlap import best_threshold
from vamgpu.metrics.parts import IN, OUT, Parts
from vamgpu.metrics.window import Windows, windows


@dataclass(frozen=True)
class Scores:
    """What one dose and one threshold make of a target.

    windows: process windows over ``peak``.  threshold: dose from which a voxel counts as printed, chosen for the best
    ``iou`` (intersection over union).  error_rate: VER, judged voxels on the wrong side of that threshold over all.
    overlap_rate: voxels out of the part with at least the least dose in it, over all (C. Rackson et al., Addit. Manuf.
    48 (2021) 102367).  dose_range: IPDR, greatest − least dose in the part over ``peak``.  least_in, greatest_in,
    greatest_out, peak, threshold: in units of the dose.  total_in: Σ dose over the part.  in_voxels, out_voxels: how
    many were judged.  missing: in the part but not printed.  excess: printed but out of the part.
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


def score(
    dose: DeviceArray, target: DeviceArray, *, level: float = 0.5, reach: float | None = None,
    threshold: float | None = None,
) -> Scores:
    """Judge a dose [x, y, z] by a target's fractions [x, y, z] on the same device.

    level: fraction from which a voxel is in the part.  reach: radius [voxels] of the judged cylinder; the inscribed one
    by default.  threshold: the best one by default.  Raises `BadInput` for a target without a voxel in the cylinder,
    `ShapeMismatch`, `DeviceError`.
    """
    parts = Parts(dose, target, level, reach)
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
    """Judged voxels out of and in the part; `BadInput` where none is in it."""
    found = above(parts, 0.0)[0].sum(axis=1)
    if not found[IN]:
        raise BadInput(
            f"no voxel within {parts.reach:g} voxels of the axis is in the part (fraction ≥ {parts.level:g}); "
            "center the target on the axis or choose a finer pitch"
        )
    return int(found[OUT]), int(found[IN])

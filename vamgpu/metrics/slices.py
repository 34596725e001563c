"""The same numbers for each slice, with the scale and the threshold of the whole volume."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.metrics.histogram import above, extremes, order_statistic
from vamgpu.metrics.parts import IN, OUT, Parts
from vamgpu.metrics.scores import Scores
from vamgpu.metrics.window import ranks


@dataclass(frozen=True, eq=False)
class SliceScores:
    """Scores of every slice, all with the peak and the threshold of the volume. NaN if a slice contains nothing of the
    part.

    Args:
        window: Least dose in the part − greatest outside, over the peak, (nz,).
        trimmed: The same with the 1 % and 99 % quantiles, (nz,).
        dose_range: IPDR, (nz,).
        iou: Intersection over union, (nz,); 1 if neither part nor print has a voxel.
        error_rate: VER, (nz,).
        in_voxels, out_voxels, missing, excess: Numbers of voxels, (nz,).
    """

    window: np.ndarray
    trimmed: np.ndarray
    dose_range: np.ndarray
    iou: np.ndarray
    error_rate: np.ndarray
    in_voxels: np.ndarray
    out_voxels: np.ndarray
    missing: np.ndarray
    excess: np.ndarray


def score_slices(dose: DeviceArray, target: DeviceArray, whole: Scores) -> SliceScores:
    """Judge every slice of a dose with the threshold and the peak of the volume.

    Args:
        dose: Dose [x, y, z] on a device.
        target: Fractions [x, y, z] on the same device.
        whole: Scores of the volume.

    Returns:
        The scores of the slices.
    """
    parts = Parts(dose, target)
    ends = extremes(parts, per_slice=True)
    counts = above(parts, whole.threshold, per_slice=True)
    voxels = counts.sum(axis=2)
    out_voxels, in_voxels = voxels[:, OUT], voxels[:, IN]
    quantile = order_statistic(parts, ranks(voxels, 0.01), per_slice=True)
    missing, excess, printed = counts[:, IN, 0], counts[:, OUT, 1], counts[:, IN, 1]
    union = in_voxels + excess
    peak, some = whole.peak or 1.0, in_voxels > 0
    least = np.where(some, ends.least[:, IN], np.nan)
    greatest_out = np.maximum(ends.greatest[:, OUT], 0.0)
    return SliceScores(
        window=(least - greatest_out) / peak,
        trimmed=(quantile[:, IN] - np.nan_to_num(quantile[:, OUT])) / peak,
        dose_range=(ends.greatest[:, IN] - least) / peak,
        iou=np.where(union > 0, printed / np.maximum(union, 1), 1.0),
        error_rate=(missing + excess) / np.maximum(voxels.sum(axis=1), 1),
        in_voxels=in_voxels,
        out_voxels=out_voxels,
        missing=missing,
        excess=excess,
    )

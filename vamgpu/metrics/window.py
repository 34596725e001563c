"""Process windows: the margin of the part's dose above all other dose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vamgpu.metrics.histogram import Extremes, order_statistic
from vamgpu.metrics.parts import IN, OUT, Parts


@dataclass(frozen=True)
class Windows:
    """Process windows over the greatest dose; if positive, some threshold prints every judged voxel correctly."""

    strict: float  # least dose in the part − greatest dose outside
    trimmed: float  # 1 % quantile in − 99 % quantile out
    fine: float  # 0.1 % in − 99.9 % out
    one_sided: float  # least in − 99 % out


def windows(parts: Parts, ends: Extremes, voxels: tuple[int, int]) -> Windows:
    """The windows of a dose; ends: its extremes over the whole; voxels: counted (out of, in) the part."""
    peak = float(ends.greatest.max()) or 1.0
    least, greatest = float(ends.least[0, IN]), max(float(ends.greatest[0, OUT]), 0.0)
    one_in, one_out = quantiles(parts, voxels, 0.01)
    fine_in, fine_out = quantiles(parts, voxels, 0.001)
    return Windows(
        strict=(least - greatest) / peak,
        trimmed=(one_in - one_out) / peak,
        fine=(fine_in - fine_out) / peak,
        one_sided=(least - one_out) / peak,
    )


def quantiles(parts: Parts, voxels: tuple[int, int], share: float) -> tuple[float, float]:
    """The ``share`` quantile in the part and the 1 − ``share`` quantile out of it, in units of the dose."""
    # Both are doses of voxels; of the two doses around a quantile, the worse one counts (NumPy's methods "lower" and
    # "higher").
    value = order_statistic(parts, ranks(np.array([voxels]), share))
    outside = value[0, OUT] if voxels[OUT] else 0.0
    return float(value[0, IN]), float(outside)


def ranks(voxels: np.ndarray, share: float) -> np.ndarray:
    """Ranks [slice, class], from 0, of the doses of `quantiles`; voxels: counted [slice, class]."""
    low, high = np.ceil((1.0 - share) * (voxels[:, OUT] - 1) - 1e-9), np.floor(share * (voxels[:, IN] - 1) + 1e-9)
    return np.maximum(np.stack([low, high], axis=1), 0.0)  # OUT is 0, IN is 1

"""Numbers about fields, computed on their device; each needs a transfer of at most 4 kB."""

from __future__ import annotations

from math import inf

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.kernels.reduce import HIGH, LOW, SUM, fold, partial_dot, partial_extent, partial_sum
from vamgpu.kernels.signature import Kernel

FOLDED = 512
"""Greatest number of partial results that are downloaded: 4 kB in float64."""

EVERYWHERE = 1e18


def parts_for(kernel: Kernel, field: DeviceArray) -> DeviceArray:
    """A table for the partial results of a kernel that runs over ``field``; one entry per work item."""
    device = field.device
    return device.empty((device.items(kernel, field.shape),), device.kept("float32"), table=True)  # type: ignore[arg-type]


def folded(parts: DeviceArray, kind: int = SUM) -> float:
    """The sum, minimum or maximum of a table of partial results."""
    device = parts.device
    if parts.shape[0] > FOLDED:
        few = device.empty((FOLDED,), parts.dtype, table=True)
        device.launch(fold, parts=parts, kind=kind, folded=few)
        parts = few
    values = parts.numpy().astype(np.float64)
    return float((np.sum, np.min, np.max)[kind](values))


def total(a: DeviceArray) -> float:
    """Σ a."""
    parts = parts_for(partial_sum, a)
    a.device.launch(partial_sum, a=a, parts=parts)
    return folded(parts)


def dot(a: DeviceArray, b: DeviceArray) -> float:
    """Σ a·b."""
    parts = parts_for(partial_dot, a)
    a.device.launch(partial_dot, a=a, b=b, parts=parts)
    return folded(parts)


def extent(
    a: DeviceArray,
    mask: DeviceArray | None = None,
    lower: float = -EVERYWHERE,
    upper: float = EVERYWHERE,
    reach: float = EVERYWHERE,
) -> tuple[float, float]:
    """Minimum and maximum of ``a`` within ``reach`` of the axis where lower ≤ mask < upper, or (inf, −inf)."""
    lows, highs = parts_for(partial_extent, a), parts_for(partial_extent, a)
    chosen = {"mask": a if mask is None else mask, "lower": lower, "upper": upper, "reach": reach}
    a.device.launch(partial_extent, a=a, **chosen, lows=lows, highs=highs)
    return folded(lows, LOW), folded(highs, HIGH)


def window(dose: DeviceArray, target: DeviceArray, reach: float, margin: float = 0.0) -> tuple[float, float, float]:
    """Least dose inside the part, greatest dose outside it, greatest dose; inside: a fraction of one half or more.

    reach: radius of the cylinder that counts, in voxels. If a part fills it all, the dose outside is −infinity. margin:
    range of fractions on either side of one half that count as neither.
    """
    inside = extent(dose, target, 0.5 + margin, inf, reach)
    outside = extent(dose, target, -inf, 0.5 - margin, reach)
    return inside[0], outside[1], max(inside[1], outside[1], extent(dose, reach=reach)[1] if margin else -inf)

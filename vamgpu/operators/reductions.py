"""Numbers about fields, computed on their device; each needs a transfer of at most 4 kB."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import inf

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.kernels.reduce import HIGH, LOW, SUM, fold, partial_dot, partial_extent, partial_sum
from vamgpu.kernels.signature import Kernel

FOLDED = 512  # greatest number of partial results that are downloaded: 4 kB in float64

EVERYWHERE = 1e18


def parts_for(kernel: Kernel, field: DeviceArray) -> DeviceArray:
    """A table for the partial results of a kernel that runs over ``field``; one entry per work item."""
    device = field.device
    return device.empty((device.items(kernel, field.shape),), device.kept("float32"), table=True)  # type: ignore[arg-type]


def folded(parts: DeviceArray, kind: int = SUM) -> float:
    """The sum, minimum or maximum of a table of partial results."""
    return all_folded([(parts, kind)])[0]


def all_folded(tables: Iterable[tuple[DeviceArray, int]]) -> list[float]:
    """`folded` of several tables; the host waits once."""
    found = list[tuple[DeviceArray, int]]()
    for parts, kind in tables:
        few = parts
        if parts.shape[0] > FOLDED:
            few = parts.device.empty((FOLDED,), parts.dtype, table=True)
            parts.device.launch(fold, parts=parts, kind=kind, folded=few)
        found.append((few, kind))
    return [float((np.sum, np.min, np.max)[kind](few.numpy().astype(np.float64))) for few, kind in found]


def sums(parts: dict[str, DeviceArray]) -> dict[str, float]:
    """The sums of tables by name; the host waits once."""
    return dict(zip(parts, all_folded((each, SUM) for each in parts.values()), strict=True))


def total(a: DeviceArray) -> float:
    """Σ a."""
    parts = parts_for(partial_sum, a)
    a.device.launch(partial_sum, a=a, parts=parts)
    return folded(parts)


def dot(a: DeviceArray, b: DeviceArray) -> float:
    """Σ a·b."""
    return dots((a, b))[0]


def dots(*pairs: tuple[DeviceArray, DeviceArray]) -> list[float]:
    """`dot` of several pairs; the host waits once."""
    tables = [parts_for(partial_dot, a) for a, _ in pairs]
    for (a, b), parts in zip(pairs, tables, strict=True):
        a.device.launch(partial_dot, a=a, b=b, parts=parts)
    return all_folded((parts, SUM) for parts in tables)


def extent(
    a: DeviceArray,
    mask: DeviceArray | None = None,
    lower: float = -EVERYWHERE,
    upper: float = EVERYWHERE,
    reach: float = EVERYWHERE,
) -> tuple[float, float]:
    """Minimum and maximum of ``a`` within ``reach`` of the axis where lower ≤ mask < upper, or (inf, −inf)."""
    return extents(a, a if mask is None else mask, [(lower, upper)], reach)[0]


def extents(
    a: DeviceArray, mask: DeviceArray, limits: Sequence[tuple[float, float]], reach: float
) -> list[tuple[float, float]]:
    """`extent` for several limits of the mask; the host waits once."""
    tables = [(parts_for(partial_extent, a), parts_for(partial_extent, a)) for _ in limits]
    for (lower, upper), (lows, highs) in zip(limits, tables, strict=True):
        chosen = {"mask": mask, "lower": lower, "upper": upper, "reach": reach}
        a.device.launch(partial_extent, a=a, **chosen, lows=lows, highs=highs)
    found = all_folded(each for lows, highs in tables for each in ((lows, LOW), (highs, HIGH)))
    return list(zip(found[::2], found[1::2], strict=True))


def window(dose: DeviceArray, target: DeviceArray, reach: float, margin: float = 0.0) -> tuple[float, float, float]:
    """Least dose in the part, greatest outside, greatest. reach: voxels; fractions within margin of ½ are neither."""
    limits = [(0.5 + margin, inf), (-inf, 0.5 - margin), (-inf, inf)]
    inside, outside, *whole = extents(dose, target, limits if margin else limits[:2], reach)
    return inside[0], outside[1], max(high for _, high in (inside, outside, *whole))

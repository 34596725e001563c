"""Process windows of a web, segment by segment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.cores import ahead, together
from vamgpu.errors import BadInput, ShapeMismatch
from vamgpu.geometry import counts, positive


@dataclass(frozen=True, eq=False)
class SegmentWindows:
    """Process windows of every segment, arrays (segments,), all over ONE ``peak``."""

    # start, stop: first voxel along l and the one after the last. least_in, greatest_out: in units of the dose. NaN if
    # a segment contains nothing of the part. in_voxels, out_voxels: how many were judged.

    start: np.ndarray
    stop: np.ndarray
    strict: np.ndarray  # least dose in the part − greatest outside
    trimmed: np.ndarray  # 1 % quantile in − 99 % quantile out
    least_in: np.ndarray
    greatest_out: np.ndarray
    in_voxels: np.ndarray
    out_voxels: np.ndarray
    peak: float

    @property
    def window(self) -> float:
        """The strict window of the whole web, with one threshold for all segments; NaN without any part."""
        least = self.least_in[self.in_voxels > 0]
        return float((least.min() - self.greatest_out.max()) / (self.peak or 1.0)) if least.size else float("nan")


def segment_windows(
    dose: DeviceArray | npt.ArrayLike, target: DeviceArray | npt.ArrayLike, segment: int, *, level: float = 0.5,
    peak: float | None = None,
) -> SegmentWindows:  # fmt: skip
    """Judge a dose [l, rho, z] by a target's fractions [l, rho, z], ``segment`` voxels along l at a time."""
    # The whole section counts. level: fraction from which a voxel is in the part. peak: divisor of windows; by default
    # the greatest dose. Give the peak of the web if tiles of a stream are judged separately.
    values, part = (np.asarray(a.numpy() if isinstance(a, DeviceArray) else a) for a in (dose, target))
    if values.shape != part.shape or values.ndim != 3 or not values.size:
        raise ShapeMismatch(f"the dose has shape {values.shape}, the target {part.shape}; expected one [l, rho, z]")
    if not np.isfinite(values).all():
        raise BadInput(f"{np.count_nonzero(~np.isfinite(values))} doses are NaN or infinite; expected finite numbers")
    length = counts("segment (voxels along l)", (segment,), 1)[0]
    top = float(values.max()) if peak is None else positive("peak", peak)
    start = np.arange(0, values.shape[0], length)
    stop = np.minimum(start + length, values.shape[0])
    rows = np.array([_judged(values[a:b], part[a:b] >= level) for a, b in zip(start, stop, strict=True)])
    least, one_in, greatest, one_out, inside, outside = rows.T
    return SegmentWindows(
        start, stop, (least - greatest) / (top or 1.0), (one_in - one_out) / (top or 1.0), least, greatest,
        inside.astype(np.int64), outside.astype(np.int64), top,
    )  # fmt: skip


def _judged(dose: np.ndarray, part: np.ndarray) -> tuple[float, ...]:
    """Least and 1 % dose in the part, greatest and 99 % dose outside, and the numbers of voxels of both."""
    inside, outside = ahead(lambda where: dose[where], (part, ~part))
    (least, one_in), (greatest, one_out) = together(lambda: _low(inside), lambda: _high(outside))
    return float(least), float(one_in), max(float(greatest), 0.0), float(one_out), inside.size, outside.size


def _low(inside: np.ndarray) -> tuple[float, float]:
    return (inside.min(), np.quantile(inside, 0.01, method="lower")) if inside.size else (np.nan, np.nan)


def _high(outside: np.ndarray) -> tuple[float, float]:
    return (outside.max(), np.quantile(outside, 0.99, method="higher")) if outside.size else (0.0, 0.0)

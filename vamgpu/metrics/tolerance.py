"""The process window as a function of the tolerance of a print.

W(δ) = (least dose at least δ deep in the part − greatest dose at least δ outside of it) / greatest dose. W(0) judges
every point of the resin; at a tolerance, W ignores points closer to the surface.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import chain
from math import ceil
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.cores import ahead
from vamgpu.errors import BadInput
from vamgpu.geometry import Grid, counts, positive
from vamgpu.metrics.depth import signed_depth, surrounded
from vamgpu.metrics.interpolation import interpolated

Array = npt.NDArray[np.floating]
Depth = Callable[[Array, Array, Array], Callable[[], Array]]
"""Function of three axes [mm]; returns the signed depth [mm] of points in the part, > 0 inside, [x, y, z]."""

WIDEST = 2.0
"""Largest tolerance of the curve, in voxels."""
BINS = 128
"""Number of steps of the curve; an even number puts half a voxel on a step."""
VOXELS, SLICES = 1 << 24, (16, 64)
"""Voxels that a thread judges at a time, and least and greatest number of slices; depths also need slices around."""
BESIDE, MEMORY = 24, 1 << 32
"""Bytes that computing the depth takes per voxel, and limit of all threads."""
_ROUNDING = 1e-4
"""Tolerance, in voxels, for the comparison of a depth with a step."""


class Slab(Protocol):
    """A dose between two heights: dose [x, y, z], on a device or in NumPy, and its voxels' positions [mm]."""

    @property
    def dose(self) -> Array | DeviceArray: ...
    @property
    def x(self) -> Array: ...
    @property
    def y(self) -> Array: ...
    @property
    def z(self) -> Array: ...


class Part(Protocol):
    """A part that can give its fractions on other voxels; a `Target` is one."""

    def resampled(self, grid: Grid, shift: tuple[float, float, float] = ...) -> Any:
        """Filled share of every voxel of ``grid`` [x, y, z], whose middle is moved by ``shift``."""
        ...


@dataclass(frozen=True, eq=False)
class ToleranceWindow:
    """The process window against the tolerance."""

    distance: Array  # the tolerances [mm], from 0 to two voxels or farther, in even steps
    least_in: Array  # least dose at least that deep in the part; infinite if no voxel is that deep
    greatest_out: Array  # greatest dose at least that far outside; 0 if no voxel is that far
    judged: Array  # share of the part's volume that is at least that deep, 0..1
    peak: float  # greatest dose of all

    @property
    def window(self) -> Array:
        """W at every tolerance; NaN if no voxel of the part is that deep."""
        least = np.where(np.isfinite(self.least_in), self.least_in, np.nan)
        return (least - self.greatest_out) / (self.peak or 1.0)

    def at(self, distance: float) -> float:
        """W at a tolerance [mm], rounded down to a step of the curve. Raises `BadInput` beyond the last step."""
        return float(self.window[self._step(distance)])

    def limits(self, distance: float) -> tuple[float, float]:
        """Least dose in the part and greatest outside at a tolerance [mm]. Raises `BadInput` beyond the last step."""
        # If no voxel is that deep, the least dose is that of the deepest voxels.
        step, deepest = self._step(distance), int(np.flatnonzero(self.judged)[-1])
        return float(self.least_in[min(step, deepest)]), float(self.greatest_out[step])

    def judged_at(self, distance: float) -> float:
        """Share of the part's volume that W at a tolerance [mm] judges. Raises `BadInput` beyond the last step."""
        return float(self.judged[self._step(distance)])

    def _step(self, distance: float) -> int:
        last = float(self.distance[-1])
        if not 0.0 <= distance <= last * (1.0 + 1e-9):
            raise BadInput(f"the tolerance is {distance!r} mm; expected 0..{last:g} mm")
        return int(distance / last * (len(self.distance) - 1) + 1e-6)


def tolerance_window(
    slabs: Iterable[Slab],
    depth: Depth,
    voxel: float,
    *,
    radius: float | None = None,
    bins: int = BINS,
    reach: float | None = None,
) -> ToleranceWindow:
    """Judge a dose slab by slab; memory holds a slab for each thread, and a few of its slices."""
    # voxel [mm]; radius [mm]; reach [mm]
    reach = WIDEST * positive("voxel [mm]", voxel) if reach is None else positive("reach [mm]", reach)
    tally = _Tally(voxel, reach, counts("bins", (bins,), 1)[0])

    def tallied(piece: _Piece) -> _Tally:
        dose, disc, found = piece
        own = _Tally(voxel, reach, bins)
        own.add(dose, found(), disc)
        return own

    pieces = _pieces(slabs, depth, radius)
    for first in pieces:
        for own in ahead(tallied, chain([first], pieces), max(MEMORY // (BESIDE * first[0].size), 1)):
            tally.take(own)
    return tally.result()


_Piece = tuple[Array, npt.NDArray[np.bool_] | None, Callable[[], Array]]


def _pieces(slabs: Iterable[Slab], depth: Depth, radius: float | None) -> Iterator[_Piece]:
    """Doses of a few slices of slabs at a time, the columns [x, y] that count, and the function for their depths."""
    for slab in slabs:
        dose = slab.dose.numpy() if isinstance(slab.dose, DeviceArray) else np.asarray(slab.dose)
        if dose.shape != (len(slab.x), len(slab.y), len(slab.z)):
            raise BadInput(f"a slab's dose has shape {dose.shape}; expected the lengths of its axes, [x, y, z]")
        disc = None if radius is None else np.hypot(slab.x[:, None], slab.y[None, :]) <= radius * (1.0 + 1e-9)
        each = int(np.clip(VOXELS // (len(slab.x) * len(slab.y)), *SLICES))
        for first in range(0, len(slab.z), each):
            some = slice(first, first + each)
            yield dose[:, :, some], disc, depth(slab.x, slab.y, slab.z[some])


class _Tally:
    """Least and greatest doses by distance from the surface."""

    def __init__(self, voxel: float, reach: float, bins: int) -> None:
        self.voxel, self.width, self.bins = voxel, reach / bins, bins
        self.least = np.full(bins + 1, np.inf)
        self.greatest = np.full(bins + 1, -np.inf)
        self.count = np.zeros(bins + 1, np.int64)
        self.peak = 0.0

    def add(self, dose: Array, depth: Array, disc: npt.NDArray[np.bool_] | None) -> None:
        """Count doses [x, y, z] at depths [mm], NaN without limits; disc: columns [x, y] that count, None for all."""
        if not np.isfinite(dose).all():
            raise BadInput("a slab's dose holds NaN or infinity; expected finite numbers")
        if disc is not None:
            dose, depth = dose[disc], depth[disc]
        known = ~np.isnan(depth)
        if not known.all():
            dose, depth = dose[known], depth[known]
        self.peak = max(self.peak, float(dose.max(initial=0.0)))
        far = self.width * self.bins
        for inside, ends, best in ((depth >= 0, self.least, np.minimum), (depth < 0, self.greatest, np.maximum)):
            beyond = inside & (np.abs(depth) >= far)  # most voxels, all of the last step
            near = inside & ~beyond
            step = (np.abs(depth[near]) / self.width + _ROUNDING * self.voxel / self.width).astype(np.int64)
            best.at(ends, step := np.minimum(step, self.bins), dose[near].astype(np.float64))
            ends[-1] = best.reduce(dose[beyond], initial=ends[-1])
            if best is np.minimum:
                self.count += np.bincount(step, minlength=self.bins + 1)
                self.count[-1] += np.count_nonzero(beyond)

    def take(self, other: _Tally) -> None:
        """Add the counts of another histogram."""
        self.least, self.greatest = np.minimum(self.least, other.least), np.maximum(self.greatest, other.greatest)
        self.count, self.peak = self.count + other.count, max(self.peak, other.peak)

    def result(self) -> ToleranceWindow:
        if not self.count.any():
            raise BadInput("the slabs contain no voxel of the part; expected the dose of the resin around the part")
        deeper = np.cumsum(self.count[::-1])[::-1]
        return ToleranceWindow(
            distance=np.arange(self.bins + 1) * self.width,
            least_in=np.minimum.accumulate(self.least[::-1])[::-1],
            greatest_out=np.maximum(np.maximum.accumulate(self.greatest[::-1])[::-1], 0.0),
            judged=deeper / deeper[0],
            peak=self.peak,
        )


# ---- depths ----------------------------------------------------------------------------------------------------
def depth_of_target(target: Part, pitch: float, voxel: float, reach: float | None = None) -> Depth:
    """Depths from the part's own surface, sampled on voxels of ``pitch`` [mm]."""
    # pitch [mm]; voxel [mm]; reach [mm]
    reach = (WIDEST * voxel if reach is None else reach) / pitch + 0.5
    halo = ceil(reach) + 2

    def depth(x: Array, y: Array, z: Array) -> Callable[[], Array]:
        middle = (_middle(x), _middle(y), _middle(z))
        grid = Grid((len(x), len(y), len(z) + 2 * halo), pitch)
        fraction = target.resampled(grid, middle).numpy()
        return lambda: signed_depth(fraction, reach)[:, :, halo:-halo] * np.float32(pitch)

    return depth


def _middle(axis: Array) -> float:
    return 0.5 * (float(axis[0]) + float(axis[-1]))


def depth_of_fractions(fraction: npt.ArrayLike, grid: Grid, flat: bool = False, reach: float | None = None) -> Depth:
    """Depths from the fractions of the part's own voxels, interpolated linearly between their centers."""
    # Midway between two surfaces, the depth is up to half a voxel less than the true one. fraction [x, y, z]; reach
    # [mm]
    reach = (WIDEST if reach is None else reach / grid.pitch) + 1.0
    margin = ceil(reach) + 1
    around = surrounded(np.asarray(fraction, np.float32), margin, flat)
    known = signed_depth(around, reach) * np.float32(grid.pitch)
    first = [axis[0] - margin * grid.pitch for axis in grid.axes()]

    def depth(x: Array, y: Array, z: Array) -> Callable[[], Array]:
        return lambda: interpolated(
            known, [(axis - start) / grid.pitch for axis, start in zip((x, y, z), first, strict=True)]
        )

    return depth

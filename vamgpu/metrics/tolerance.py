"""The process window as a function of the tolerance δ of a print.

W(δ) = (least dose δ or more deep in the part − greatest δ or more outside) / greatest dose.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from math import ceil, inf
from typing import Protocol

import numpy as np
import numpy.typing as npt

from vamgpu.backend import open_device
from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.geometry import Grid, counts, positive
from vamgpu.kernels.depth import tally_depths
from vamgpu.metrics.depth import depth_field, signed_depth, surrounded
from vamgpu.metrics.interpolation import interpolated

Array = npt.NDArray[np.floating]
Depth = Callable[[Array, Array, Array], DeviceArray]
"""Function of three axes [mm]; returns the signed depth [mm] of points in the part, > 0 inside, a field [x, y, z];
`NO_DEPTH` for points that do not count."""

WIDEST = 2.0  # largest tolerance of the curve, in voxels
BINS = 128  # number of steps of the curve; an even number puts half a voxel on a step
_ROUNDING = 1e-4  # tolerance, in voxels, for the comparison of a depth with a step


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

    def resampled(
        self, grid: Grid, shift: tuple[float, float, float] = ..., device: Device | None = ...
    ) -> DeviceArray:
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
        """Least dose in the part (infinite if it is thinner) and greatest outside at a tolerance [mm]."""
        step = self._step(distance)
        return float(self.least_in[step]), float(self.greatest_out[step])

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
    """Judge a dose slab by slab, on the device of the depths."""
    # voxel [mm]; radius [mm]; reach [mm]
    reach = WIDEST * positive("voxel [mm]", voxel) if reach is None else positive("reach [mm]", reach)
    tally = _Tally(voxel, reach, counts("bins", (bins,), 1)[0])
    for slab in slabs:
        if slab.dose.shape != (len(slab.x), len(slab.y), len(slab.z)):
            raise BadInput(f"a slab's dose has shape {slab.dose.shape}; expected the lengths of its axes, [x, y, z]")
        disc = np.hypot(slab.x[:, None], slab.y) <= (inf if radius is None else radius * (1.0 + 1e-9))
        tally.add(slab.dose, depth(slab.x, slab.y, slab.z), disc)
    return tally.result()


class _Tally:
    """Least and greatest doses by distance from the surface."""

    def __init__(self, voxel: float, reach: float, bins: int) -> None:
        self.width, self.bins = reach / bins, bins
        self.rounding = _ROUNDING * voxel / self.width
        self.least, self.greatest = np.full(bins + 1, inf), np.full(bins + 1, -inf)
        self.count = np.zeros(bins + 1, np.int64)
        self.peak = 0.0

    def add(self, dose: Array | DeviceArray, depth: DeviceArray, disc: npt.NDArray[np.bool_]) -> None:
        """Count doses [x, y, z] at depths [mm]; disc: columns [x, y] that count, in one piece along y."""
        device = depth.device
        field = dose if isinstance(dose, DeviceArray) else device.upload(dose)
        field = field if field.device is device else device.upload(field.numpy())
        begin = disc.argmax(axis=1)
        ends = device.table(np.stack([begin, begin + disc.sum(axis=1)], axis=1), "int32")
        shape = device.items(tally_depths, field.shape), self.bins + 2  # type: ignore[arg-type]
        least, greatest = (device.empty(shape, device.kept("float32"), table=True) for _ in range(2))
        found = {"least": least, "greatest": greatest, "counts": device.empty(shape, "uint32", table=True)}
        given = {"ends": ends, "width": self.width, "rounding": self.rounding}
        device.launch(tally_depths, dose=field, depth=depth, **given, **found)
        low, high = least.numpy().min(axis=0), greatest.numpy().max(axis=0)
        if np.isnan(high[-1]):
            raise BadInput("a slab's dose holds NaN or infinity; expected finite numbers")
        self.peak = max(self.peak, float(high[-1]))
        self.least, self.greatest = np.minimum(self.least, low[:-1]), np.maximum(self.greatest, high[:-1])
        self.count += found["counts"].numpy().sum(axis=0, dtype=np.int64)[:-1]

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


def depth_of_target(
    target: Part, pitch: float, voxel: float, reach: float | None = None, device: Device | None = None
) -> Depth:
    """Depths from the part's own surface, sampled on voxels of ``pitch`` [mm]."""
    # pitch [mm]; voxel [mm]; reach [mm]
    reach = (WIDEST * voxel if reach is None else reach) / pitch + 0.5
    halo = ceil(reach) + 2

    def depth(x: Array, y: Array, z: Array) -> DeviceArray:
        grid = Grid((len(x), len(y), len(z) + 2 * halo), pitch)
        fraction = target.resampled(grid, (_middle(x), _middle(y), _middle(z)), device)
        return depth_field(fraction, reach, halo, len(z), pitch)

    return depth


def _middle(axis: Array) -> float:
    return 0.5 * (float(axis[0]) + float(axis[-1]))


def depth_of_fractions(
    fraction: npt.ArrayLike, grid: Grid, flat: bool = False, reach: float | None = None, device: Device | None = None
) -> Depth:
    """Depths from the fractions of the part's own voxels, interpolated linearly between their centers."""
    # Midway between two surfaces, the depth is up to half a voxel less than the true one. fraction [x, y, z]; reach
    # [mm]
    reach = (WIDEST if reach is None else reach / grid.pitch) + 1.0
    margin, place = ceil(reach) + 1, open_device(device)
    around = surrounded(np.asarray(fraction, np.float32), margin, flat)
    known = signed_depth(around, reach, place) * np.float32(grid.pitch)
    first = [axis[0] - margin * grid.pitch for axis in grid.axes()]

    def depth(x: Array, y: Array, z: Array) -> DeviceArray:
        at = [(axis - start) / grid.pitch for axis, start in zip((x, y, z), first, strict=True)]
        return place.upload(interpolated(known, at))

    return depth

"""The greatest dose beyond the judged cylinder: beside, above and below it."""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot, inf

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.geometry import Grid
from vamgpu.metrics.histogram import extremes
from vamgpu.metrics.parts import EVERYWHERE, IN, Parts
from vamgpu.metrics.thin_regions import IN_THE_PART


@dataclass(frozen=True)
class Outer:
    """The greatest dose beside, above and below the judged cylinder, a pixel or more from the part."""

    dose: float  # on one voxel, in units of Aᵀ(light)
    place: tuple[float, float, float]  # its center x, y, z [mm]
    width: float  # of the voxel [mm]: the part's, or wider beyond the corners of the grid if the resin reaches far
    radius: float  # greatest distance from the axis that was searched [mm]: the inner wall, or else the grid's corners

    @property
    def distance(self) -> float:
        """Distance from the axis [mm]."""
        return hypot(*self.place[:2])

    @property
    def where(self) -> str:
        """The place in words."""
        return f"{self.distance:.3g} of {self.radius:.3g} mm from the axis, at z = {self.place[2]:+.3g} mm"


def corner_of(grid: Grid) -> float:
    """Distance of a grid's corners from the axis [mm]."""
    return 0.5 * grid.pitch * hypot(*grid.shape[:2])


class Around:
    """Resin within a pixel of the voxels of a part: its surface may deviate by a pixel on every side."""

    def __init__(self, fraction: np.ndarray, grid: Grid, pixel: float) -> None:
        # fraction [x, y, z] of the grid; pixel [mm]
        from scipy.spatial import KDTree

        self._reach = reach = (pixel + 0.5 * grid.pitch) * (1.0 + 1e-9)
        x, y, z = grid.axes()
        away, high = np.hypot(x[:, None], y), np.abs(z)
        ends = (away > grid.inscribed_radius - reach)[:, :, None] | (high > 0.5 * grid.shape[2] * grid.pitch - reach)
        i, j, k = np.nonzero(ends & (fraction >= IN_THE_PART))
        self._far, self._high = (float(ends.max(initial=-inf)) + reach for ends in (away[i, j], high[k]))
        self._tree = KDTree(np.stack([x[i], y[j], z[k]], axis=1))

    def leave_out(self, beyond: np.ndarray, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> None:
        """Clear such resin from a mask of voxels beyond the judged cylinder."""
        # beyond [column, column, z]; x, y [column, column] [mm]; z [mm]
        i, j, k = np.nonzero(beyond & (np.hypot(x, y) <= self._far)[:, :, None] & (np.abs(z) <= self._high))
        points = np.stack([x[i, j], y[i, j], z[k]], axis=1)
        near = self._tree.query(points, distance_upper_bound=self._reach, workers=-1)[0] < inf
        beyond[i[near], j[near], k[near]] = False


def greatest_beyond(
    grid: Grid, radius: float, dose: DeviceArray, axes: tuple[np.ndarray, ...], width: float,
    best: Outer | None = None, around: Around | None = None,
) -> Outer | None:  # fmt: skip
    """The greatest dose that the scores do not judge, except around the part."""
    # radius [mm]; dose [x, y, z]; axes [mm]; width [mm]
    x, y, z = axes
    distance = np.hypot(x[:, None], y[None, :])
    beside, off = distance > grid.inscribed_radius * (1.0 + 1e-12), np.abs(z) > 0.5 * grid.shape[2] * grid.pitch
    beyond = np.zeros(dose.shape, bool)
    beyond[:, :, : z.size] = (distance <= radius)[:, :, None] & (beside[:, :, None] | off)
    if around is not None:
        around.leave_out(beyond[:, :, : z.size], *np.meshgrid(x, y, indexing="ij"), z)
    if not beyond.any():
        return best
    greatest = extremes(Parts(dose, dose.device.upload(beyond), reach=EVERYWHERE), per_slice=True).greatest[:, IN]
    k = int(np.argmax(greatest))
    if best is not None and greatest[k] <= best.dose:
        return best
    i, j = np.unravel_index(int(np.argmax(np.where(beyond[:, :, k], dose.numpy()[:, :, k], -inf))), beyond.shape[:2])
    return Outer(float(greatest[k]), (float(x[i]), float(y[j]), float(z[k])), width, radius)

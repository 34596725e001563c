"""The greatest dose that scores do not judge: beside, above and below their cylinder."""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot, inf

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.geometry import Grid
from vamgpu.metrics.histogram import extremes
from vamgpu.metrics.parts import EVERYWHERE, IN, Parts


@dataclass(frozen=True)
class Outer:
    """The greatest dose beside, above and below the cylinder that is judged.

    dose: on one voxel, in units of Aᵀ(light).  place: its center x, y, z [mm].  width: of the voxel [mm]: the part's,
    or wider beyond the corners of the grid where the resin reaches much farther.  radius: how far from the axis was
    looked [mm]: to the inner wall, else to the corners of the grid.
    """

    dose: float
    place: tuple[float, float, float]
    width: float
    radius: float

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


def greatest_beyond(
    grid: Grid, radius: float, dose: DeviceArray, axes: tuple[np.ndarray, ...], width: float, best: Outer | None = None
) -> Outer | None:
    """The greatest dose that the scores do not judge."""
    # radius [mm]; dose [x, y, z]; axes [mm]; width [mm]
    x, y, z = axes
    distance = np.hypot(x[:, None], y[None, :])
    beside, off = distance > grid.inscribed_radius * (1.0 + 1e-12), np.abs(z) > 0.5 * grid.shape[2] * grid.pitch
    beyond = np.zeros(dose.shape, bool)
    beyond[:, :, : z.size] = (distance <= radius)[:, :, None] & (beside[:, :, None] | off)
    if not beyond.any():
        return best
    greatest = extremes(Parts(dose, dose.device.upload(beyond), reach=EVERYWHERE), per_slice=True).greatest[:, IN]
    k = int(np.argmax(greatest))
    if best is not None and greatest[k] <= best.dose:
        return best
    i, j = np.unravel_index(int(np.argmax(np.where(beyond[:, :, k], dose.numpy()[:, :, k], -inf))), beyond.shape[:2])
    return Outer(float(greatest[k]), (float(x[i]), float(y[j]), float(z[k])), width, radius)

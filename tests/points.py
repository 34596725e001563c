"""A slice whose pixels are points without size, projected into bins.

Source: B. Wang et al., Lateral contrast enhancement via binary photoinhibition, Fig. 6.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import ceil, hypot
from typing import final

import numpy as np
import numpy.typing as npt

from vamgpu.backend import open_device
from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.geometry import Beam, Grid, Turntable, positive
from vamgpu.operators.linear import LinearOperator
from vamgpu.operators.space import SinogramSpace, VolumeSpace


@final
class PointProjection(LinearOperator):
    """One slice of points and one row of bins on the ``numpy`` device. Raises `BadInput`."""

    # A point weighs exp(−absorption·l) times its angle's time over the mean, l the path [mm] from the wall of a volume
    # whose diameter is the diagonal; the slice stands still while an angle is lit, as in the paper.

    grid: Grid  # a slice, one voxel along z
    motion: Turntable  # the angles
    beam: Beam
    domain: VolumeSpace
    range: SinogramSpace
    vessel = None

    def __init__(self, grid: Grid, motion: Turntable, width: float = 1.0, absorption: float = 0.0) -> None:
        if grid.shape[2] != 1:
            raise BadInput(f"{grid!r} has {grid.shape[2]} slices; expected one: use Projection for volumes")
        self.width: float = positive("width [pixels]", width) * grid.pitch
        self.absorption: float = positive("absorption [1/mm]", absorption, zero=True)
        self.radius: float = 0.5 * hypot(*grid.shape[:2]) * grid.pitch
        bins = ceil(2.0 * self.radius / self.width * (1.0 - 1e-12))
        self.grid, self.motion, self.beam = grid, motion.stepped, Beam((bins, 1), self.width)
        self.domain = VolumeSpace(grid)  # pyright: ignore[reportIncompatibleVariableOverride] - and never replaced
        self.range = SinogramSpace(self.beam, self.motion)  # pyright: ignore[reportIncompatibleVariableOverride]
        self.device: Device = open_device("numpy")

    def _rays(self) -> Iterator[tuple[npt.NDArray[np.intp], npt.NDArray[np.float64]]]:
        """Bins and weights of all points, an angle at a time."""
        x, y, _ = self.grid.axes()
        bins = self.beam.pixels[0]
        for theta, time in zip(self.motion.poses, self.motion.times, strict=True):
            across = (y * np.cos(theta))[None, :] - (x * np.sin(theta))[:, None]
            which = np.clip(np.floor(across / self.width + 0.5 * bins).astype(np.intp), 0, bins - 1)
            if not self.absorption:
                yield which, np.full(which.shape, time)
                continue
            along = (x * np.cos(theta))[:, None] + (y * np.sin(theta))[None, :]
            path = np.sqrt(np.maximum(self.radius**2 - across**2, 0.0)) - along
            yield which, time * np.exp(-self.absorption * path)

    def forward(self, x: DeviceArray, out: DeviceArray) -> None:
        bins, values, rows = self.beam.pixels[0], x.handle[:, :, 0], out.handle
        for k, (which, weight) in enumerate(self._rays()):
            rows[k, :, 0] = np.bincount(which.ravel(), (weight * values).ravel(), bins)

    def transposed(self, y: DeviceArray, out: DeviceArray) -> None:
        dose = np.zeros(self.grid.shape[:2])
        for k, (which, weight) in enumerate(self._rays()):
            dose += weight * y.handle[k, which, 0]
        out.handle[:, :, 0] = dose

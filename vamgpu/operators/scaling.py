"""A volume whose voxels are multiplied by their own factors."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from vamgpu.backend import open_device
from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.geometry import Grid
from vamgpu.kernels.update import multiply
from vamgpu.operators.linear import LinearOperator
from vamgpu.operators.space import VolumeSpace, require
from vamgpu.web import WebGrid


class Scaled(LinearOperator):
    """Multiplies every voxel [x, y, z] by a factor; its own transpose. Raises `BadInput`, `ShapeMismatch`."""

    def __init__(self, grid: Grid | WebGrid, factors: npt.ArrayLike, device: str | Device | None = None) -> None:
        values = np.asarray(factors, np.float32)
        if not np.isfinite(values).all():
            raise BadInput("factors of voxels hold NaN or infinity; expected finite numbers")
        space = VolumeSpace(grid)
        require(space, values, "the factors")
        self.grid: Grid | WebGrid = grid
        self._set_spaces(space, space, open_device(device))
        self.factors: DeviceArray = self.device.upload(values)

    def __repr__(self) -> str:
        return f"Scaled({self.grid!r}, device={self.device.name!r})"

    def forward(self, x: DeviceArray, out: DeviceArray) -> None:
        self.device.launch(multiply, x=x, y=self.factors, out=out)

    def transposed(self, y: DeviceArray, out: DeviceArray) -> None:
        self.forward(y, out)

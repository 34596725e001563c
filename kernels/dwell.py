"""Light of every angle times the time that the angle is lit."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from vamgpu.kernels.signature import Sinogram, SinogramOut, Table, Tiling, kernel

Times = Annotated[np.ndarray, Table("float32", ("pose",))]


@kernel(over="weighted", cpu=Tiling(major=1, minor=0), gpu=Tiling(major=1, minor=1))
def weigh_poses(light: Sinogram, times: Times, weighted: SinogramOut) -> None:
    """weighted[a] = light[a] · times[a mod poses], because tiles repeat the angles of a turn; weighted may be light."""
    angles = light.shape[0]
    weighted[...] = light * np.resize(times, angles)[:, None, None]

"""Light of every angle times the time that the angle is lit."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from vamgpu.kernels.pointwise import cyclic, pointwise
from vamgpu.kernels.signature import Sinogram, SinogramOut, Table

Times = Annotated[np.ndarray, Table("float32", ("pose",))]


@pointwise(over="weighted")
def weigh_poses(light: Sinogram, times: Times, weighted: SinogramOut) -> None:
    """weighted[a] = light[a] · times[a mod poses], because tiles repeat the angles of a turn; weighted may be light."""
    weighted[...] = light * cyclic(times, light)

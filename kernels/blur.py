"""Blurring along z by a symmetric table of taps; along r see `filter`."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from vamgpu.kernels.filter import Taps, convolve
from vamgpu.kernels.signature import ArrayOut, Field, Tiling, kernel

Sharp = Annotated[np.ndarray, Field(("i", "j", "z"))]


@kernel(over="blurred", reach="tap", cpu=Tiling(major=1, minor=0))
def blur_slices(source: Sharp, taps: Taps, blurred: ArrayOut) -> None:
    """blurred[i, j, z] = Σ_t taps[|t|] · source[i, j, z + t], 0 beyond the edge: its own transpose."""
    blurred[...] = convolve(source.swapaxes(1, 2), taps, 1).swapaxes(1, 2)

"""Blurring along the first axis by a symmetric table of taps; along the second see `filter`, along z `blur`."""

from __future__ import annotations

from vamgpu.kernels.blur import Sharp
from vamgpu.kernels.filter import Taps, convolve
from vamgpu.kernels.signature import ArrayOut, Tiling, kernel


@kernel(over="blurred", cpu=Tiling(major=1, minor=0))
def blur_planes(source: Sharp, taps: Taps, blurred: ArrayOut) -> None:
    """blurred[i, j, z] = Σ_t taps[|t|] · source[i + t, j, z], 0 beyond the edge: its own transpose."""
    blurred[...] = convolve(source.swapaxes(0, 1), taps, 1).swapaxes(0, 1)

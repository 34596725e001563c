"""Blurring along the first axis by a symmetric table of taps; along the second see `filter`, along z `blur`."""

from __future__ import annotations

from vamgpu.kernels.blur import Sharp
from vamgpu.kernels.filter import Taps
from vamgpu.kernels.signature import ArrayOut, Tiling, kernel


@kernel(over="blurred", cpu=Tiling(major=1, minor=0))
def blur_planes(source: Sharp, taps: Taps, blurred: ArrayOut) -> None:
    """blurred[i, j, z] = Σ_t taps[|t|] · source[i + t, j, z], 0 beyond the edge: its own transpose."""
    blurred[...] = taps[0] * source
    for t in range(1, min(len(taps), source.shape[0])):
        blurred[t:] += taps[t] * source[:-t]
        blurred[:-t] += taps[t] * source[t:]

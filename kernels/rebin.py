"""Rebinning of parallel light to the rays that a vessel bends: (θ, r) → (θ', r')."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from vamgpu.kernels.signature import Field, SinogramOut, Table, Tiling, kernel

Rays = Annotated[np.ndarray, Table("float32", ("r", "3"))]
"""Angle and column in the parallel sinogram, relative to (angle, 0), in samples; gain."""
Parallel = Annotated[np.ndarray, Field(("angle", "column", "z"))]


@kernel(over="light", cpu=Tiling(major=1, minor=0), gpu=Tiling(major=1, minor=1))
def rebin_rays(parallel: Parallel, rays: Rays, light: SinogramOut) -> None:
    """light[a, r, z] = gain_r · parallel at angle a + turn_r (cyclic) and column_r, bilinear; 0 beyond."""
    angles, columns = parallel.shape[:2]
    light[...] = 0.0
    for r, (turn, column, gain) in enumerate(rays):
        first, near = int(np.floor(turn)), int(np.floor(column))
        for k, share in ((0, 1.0 - (turn - first)), (1, turn - first)):
            for c, part in ((near, 1.0 - (column - near)), (near + 1, column - near)):
                if 0 <= c < columns:
                    light[:, r] += gain * share * part * np.roll(parallel[:, c], -(first + k), axis=0)

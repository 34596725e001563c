"""Warp version of `flip`; a thread owns four lanes of z."""

from __future__ import annotations

import warp as wp

from vamgpu.kernels.wide_warp import Vectors

wp.set_module_options({"enable_backward": False, "fast_math": False})


@wp.kernel
def step_pixels(
    brighter: Vectors, darker: Vectors, worth: float, seed: int, first: int, step: float, most: float,
    light: Vectors, n_i: int, n_j: int, n_z: int,
) -> None:  # fmt: skip
    slab, i, j, lane = wp.tid()
    up = brighter[slab, i, j, lane]
    down = darker[slab, i, j, lane]
    shown = light[slab, i, j, lane]
    column = wp.uint32(i) * wp.uint32(3518319155) + wp.uint32(j) * wp.uint32(2882110345)
    column = column + wp.uint32(seed) * wp.uint32(2654435769)
    for k in range(4):
        z = first + 4 * (slab * light.shape[3] + lane) + k
        place = column + wp.uint32(z) * wp.uint32(2360945575)
        if float(place >> wp.uint32(8)) / 16777216.0 * worth < -wp.min(up[k], down[k]):
            by = step
            if up[k] > down[k]:
                by = -step
            shown[k] = wp.clamp(shown[k] + by, 0.0, most)
    light[slab, i, j, lane] = shown

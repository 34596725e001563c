"""Warp version of `camera`; a thread owns four lanes of z of one pixel's column."""

from __future__ import annotations

from typing import Any

import warp as wp

from vamgpu.kernels.wide_warp import Vectors

wp.set_module_options({"enable_backward": False, "fast_math": False})

BRIGHT: Any = wp.constant(4.0)  # the square of FAINTEST
TURN: Any = wp.constant(6.283185307179586)


@wp.kernel
def measure_depth(
    images: wp.array3d[float], open: wp.array3d[float], reached: wp.array[float], floor: float, gain: float,
    brightest: float, depth: Vectors, weight: Vectors, n_angle: int, n_z: int, n_r: int, n_shot: int,
) -> None:  # fmt: skip
    slab, angle, r, lane = wp.tid()
    share = reached[r]
    found = wp.vec4(0.0, 0.0, 0.0, 0.0)
    known = wp.vec4(0.0, 0.0, 0.0, 0.0)
    for k in range(4):
        z = 4 * (slab * depth.shape[3] + lane) + k
        if z < n_z and share > 0.0:
            level = images[angle, z, r]
            field = open[angle % n_shot, z, r]
            variance = floor + gain * wp.max(level, 0.0)
            if field > 0.0 and level < brightest and level * level > BRIGHT * variance:
                found[k] = share * wp.log(field / level)
                known[k] = level * level / (variance * share * share)
    depth[slab, angle, r, lane] = found
    weight[slab, angle, r, lane] = known


@wp.func
def hashed(number: wp.uint32) -> wp.uint32:
    state = number * wp.uint32(747796405) + wp.uint32(2891336453)
    word = ((state >> ((state >> wp.uint32(28)) + wp.uint32(4))) ^ state) * wp.uint32(277803737)
    return (word >> wp.uint32(22)) ^ word


@wp.func
def share_of(number: wp.uint32) -> float:
    """A number between 0 and 1."""
    return (float(number >> wp.uint32(8)) + 0.5) / 16777216.0


@wp.kernel
def draw_noise(
    weight: Vectors, slices: wp.array[int], seed: int, noise: Vectors, n_angle: int, n_r: int, n_z: int
) -> None:
    slab, angle, r, lane = wp.tid()
    z = 4 * (slab * weight.shape[3] + lane)
    known = weight[slab, angle, r, lane]
    column = hashed(wp.uint32(angle * n_r + r) + wp.uint32(seed) * wp.uint32(2654435769))
    found = wp.vec4(0.0, 0.0, 0.0, 0.0)
    for k in range(4):
        if z + k < n_z and known[k] > 0.0:
            first = hashed(column + wp.uint32(slices[z + k]))
            second = hashed(first)
            found[k] = wp.sqrt(-2.0 * wp.log(share_of(first)) / known[k]) * wp.cos(TURN * share_of(second))
    noise[slab, angle, r, lane] = found

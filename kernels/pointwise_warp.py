"""What the Warp versions of pointwise kernels call."""

from __future__ import annotations

from typing import Any

import warp as wp

from vamgpu.kernels.pointwise import PARTIAL
from vamgpu.kernels.wide_warp import Vectors as Vectors

wp.set_module_options({"enable_backward": False, "fast_math": False})

ROWS: Any = wp.constant(PARTIAL.major)


@wp.func
def part_index(slab: int, tile: int, j: int, lane: int, n_i: int, n_j: int, n_lane: int):
    tiles = (n_i + ROWS - 1) // ROWS
    return ((slab * tiles + tile) * n_j + j) * n_lane + lane


@wp.func
def disc_distance(i: int, j: int, n_i: int, n_j: int):
    a = float(i) - 0.5 * float(n_i - 1)
    b = float(j) - 0.5 * float(n_j - 1)
    return a * a + b * b


@wp.func
def look_up(dose: float, samples: wp.array[float], start: float, density: float):
    position = (dose - start) * density
    cell = wp.clamp(int(wp.floor(wp.min(position, 1.0e9))), 0, samples.shape[0] - 2)
    rise = samples[cell + 1] - samples[cell]
    return samples[cell] + rise * (position - float(cell)), rise


@wp.func
def raised(x: float, power: float):
    """x to a power, at least 0."""
    result = float(1.0)
    if power == 1.0:
        result = x
    elif power != 0.0:
        result = wp.pow(x, power)
    return result

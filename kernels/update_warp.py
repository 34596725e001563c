"""Warp version of `update`; a thread owns four lanes of z of one sample."""

from __future__ import annotations

import warp as wp

from vamgpu.kernels.partial_warp import ROWS, disc_distance, part_index, real_lanes
from vamgpu.kernels.wide_warp import Vectors

wp.set_module_options({"enable_backward": False, "fast_math": False})


@wp.kernel
def linear(
    a: float, x: Vectors, b: float, y: Vectors, floor: float, out: Vectors, n_i: int, n_j: int, n_z: int
) -> None:
    slab, i, j, lane = wp.tid()
    lowest = wp.vec4(floor, floor, floor, floor)
    out[slab, i, j, lane] = wp.max(lowest, a * x[slab, i, j, lane] + b * y[slab, i, j, lane])


@wp.kernel
def multiply(x: Vectors, y: Vectors, out: Vectors, n_i: int, n_j: int, n_z: int) -> None:
    slab, i, j, lane = wp.tid()
    out[slab, i, j, lane] = wp.cw_mul(x[slab, i, j, lane], y[slab, i, j, lane])


@wp.kernel
def apply_penalty(
    light: Vectors, weight: float, power: float, hold: int, most: float, gradient: Vectors, parts: wp.array[float],
    n_i: int, n_j: int, n_z: int, n_part: int,
) -> None:  # fmt: skip
    slab, tile, j, lane = wp.tid()
    count = real_lanes(slab, lane, light.shape[3], n_z)
    result = float(0.0)
    for i in range(tile * ROWS, wp.min(tile * ROWS + ROWS, n_i)):
        value = gradient[slab, i, j, lane]
        lit = light[slab, i, j, lane]
        for k in range(count):
            if weight != 0.0:
                root = float(1.0)
                if power != 1.0:
                    root = wp.pow(wp.max(lit[k], 0.0), power - 1.0)
                value[k] = value[k] + weight * power * root
                result += root * wp.max(lit[k], 0.0)
            if hold != 0 and lit[k] <= 0.0:
                value[k] = wp.min(value[k], 0.0)
            if hold != 0 and lit[k] >= most:
                value[k] = wp.max(value[k], 0.0)
        gradient[slab, i, j, lane] = value
    parts[part_index(slab, tile, j, lane, n_i, n_j, light.shape[3])] = weight * result


@wp.kernel
def fill_background(
    target: Vectors, low: float, high: float, reach: float, model: Vectors, n_i: int, n_j: int, n_z: int
) -> None:
    slab, i, j, lane = wp.tid()
    value = wp.vec4(0.0, 0.0, 0.0, 0.0)
    if disc_distance(i, j, n_i, n_j) <= reach * reach:
        value = wp.vec4(low, low, low, low) + (high - low) * target[slab, i, j, lane]
    model[slab, i, j, lane] = value


@wp.kernel
def correct_by_ratio(
    dose: Vectors, scale: float, target: Vectors, low: float, high: float, most: float, model: Vectors,
    n_i: int, n_j: int, n_z: int,
) -> None:  # fmt: skip
    slab, i, j, lane = wp.tid()
    value = model[slab, i, j, lane]
    doses = dose[slab, i, j, lane]
    fractions = target[slab, i, j, lane]
    for k in range(4):
        required = low + (high - low) * fractions[k]
        got = wp.max(wp.max(doses[k] * scale, required / most), 1.0e-30)
        value[k] = value[k] * wp.min(required / got, most)
    model[slab, i, j, lane] = value


@wp.kernel
def correct_by_difference(
    dose: Vectors, scale: float, target: Vectors, low: float, high: float, gain_outside: float, gain_inside: float,
    reach: float, model: Vectors,
    n_i: int, n_j: int, n_z: int,
) -> None:  # fmt: skip
    slab, i, j, lane = wp.tid()
    if disc_distance(i, j, n_i, n_j) <= reach * reach:
        value = model[slab, i, j, lane]
        doses = dose[slab, i, j, lane]
        fractions = target[slab, i, j, lane]
        for k in range(4):
            if fractions[k] >= 0.5:
                value[k] = value[k] + gain_inside * wp.max(0.0, high - doses[k] * scale)
            else:
                value[k] = value[k] - gain_outside * wp.max(0.0, doses[k] * scale - low)
        model[slab, i, j, lane] = value

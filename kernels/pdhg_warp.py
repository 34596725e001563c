"""Warp version of `pdhg`; a thread owns four lanes of z of one sample, or of a column of `ROWS` of them."""

from __future__ import annotations

import warp as wp

from vamgpu.kernels.partial_warp import ROWS, disc_distance, part_index, real_lanes
from vamgpu.kernels.wide_warp import Vectors

wp.set_module_options({"enable_backward": False, "fast_math": False})


@wp.kernel
def primal_step(
    light: Vectors, columns: Vectors, step: float, ahead: Vectors, after: Vectors, moved: wp.array[float],
    n_i: int, n_j: int, n_z: int, n_part: int,
) -> None:  # fmt: skip
    slab, tile, j, lane = wp.tid()
    count = real_lanes(slab, lane, light.shape[3], n_z)
    result = float(0.0)
    for i in range(tile * ROWS, wp.min(tile * ROWS + ROWS, n_i)):
        before = light[slab, i, j, lane]
        falls = ahead[slab, i, j, lane]
        weight = columns[slab, i, j, lane]
        to = wp.vec4(0.0, 0.0, 0.0, 0.0)
        for k in range(4):
            if weight[k] > 0.0:
                to[k] = wp.max(0.0, before[k] - step / weight[k] * falls[k])
            if k < count:
                result += weight[k] * (to[k] - before[k]) * (to[k] - before[k])
        after[slab, i, j, lane] = to
        ahead[slab, i, j, lane] = 2.0 * to - before
    moved[part_index(slab, tile, j, lane, n_i, n_j, light.shape[3])] = result


@wp.kernel
def dual_step(
    ahead: Vectors, held: Vectors, target: Vectors, rows: Vectors, least: float, leak: float, step: float,
    reach: float, lower: Vectors, upper: Vectors, lower_after: Vectors, upper_after: Vectors,
    inside: wp.array[float], outside: wp.array[float], moved: wp.array[float], crossed: wp.array[float],
    n_i: int, n_j: int, n_z: int, n_part: int,
) -> None:  # fmt: skip
    slab, tile, j, lane = wp.tid()
    count = real_lanes(slab, lane, lower.shape[3], n_z)
    within = float(0.0)
    beyond = float(0.0)
    far = float(0.0)
    product = float(0.0)
    for i in range(tile * ROWS, wp.min(tile * ROWS + ROWS, n_i)):
        circle = disc_distance(i, j, n_i, n_j) <= reach * reach
        row = rows[slab, i, j, lane]
        dose = ahead[slab, i, j, lane]
        past = held[slab, i, j, lane]
        body = target[slab, i, j, lane]
        low = lower[slab, i, j, lane]
        high = upper[slab, i, j, lane]
        to = wp.vec4(0.0, 0.0, 0.0, 0.0)
        most = wp.vec4(0.0, 0.0, 0.0, 0.0)
        for k in range(4):
            weight = float(1.0)
            if circle and row[k] > 0.0:
                weight = row[k]
                excess = dose[k] - leak
                if body[k] >= 0.5:
                    excess = least - dose[k]
                    most[k] = wp.max(0.0, high[k] + step * (dose[k] - 1.0) / weight)
                to[k] = wp.max(0.0, low[k] + step * excess / (weight + 1.0))
            if k < count:
                higher = to[k] - low[k]
                tighter = most[k] - high[k]
                change = higher
                if body[k] >= 0.5:
                    within += to[k]
                    change = tighter - higher
                else:
                    beyond += to[k]
                far += (weight + 1.0) * higher * higher + weight * tighter * tighter
                product += change * 0.5 * (dose[k] - past[k])
        lower_after[slab, i, j, lane] = to
        upper_after[slab, i, j, lane] = most
    part = part_index(slab, tile, j, lane, n_i, n_j, lower.shape[3])
    inside[part] = within
    outside[part] = beyond
    moved[part] = far
    crossed[part] = product


@wp.kernel
def dual_dose(lower: Vectors, upper: Vectors, target: Vectors, pull: Vectors, n_i: int, n_j: int, n_z: int) -> None:
    slab, i, j, lane = wp.tid()
    cost = lower[slab, i, j, lane]
    body = target[slab, i, j, lane]
    high = upper[slab, i, j, lane]
    for k in range(4):
        if body[k] >= 0.5:
            cost[k] = high[k] - cost[k]
    pull[slab, i, j, lane] = cost


@wp.kernel
def reflect(step: Vectors, anchor: Vectors, share: float, now: Vectors, n_i: int, n_j: int, n_z: int) -> None:
    slab, i, j, lane = wp.tid()
    now[slab, i, j, lane] = (
        share * (2.0 * step[slab, i, j, lane] - now[slab, i, j, lane]) + (1.0 - share) * anchor[slab, i, j, lane]
    )

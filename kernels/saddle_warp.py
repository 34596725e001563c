"""Warp siblings of `saddle`; a thread owns four lanes of z of one sample, or of a column of `ROWS` of them."""

from __future__ import annotations

import warp as wp

from vamgpu.kernels.partial_warp import ROWS, disc_distance, part_index, real_lanes
from vamgpu.kernels.wide_warp import Vectors

wp.set_module_options({"enable_backward": False, "fast_math": False})


@wp.kernel
def light_step(
    light: Vectors, columns: Vectors, step: float, most: float, ahead: Vectors, after: Vectors, moved: wp.array[float],
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
                to[k] = wp.min(most, wp.max(0.0, before[k] - step / weight[k] * falls[k]))
            if k < count:
                result += weight[k] * (to[k] - before[k]) * (to[k] - before[k])
        after[slab, i, j, lane] = to
        ahead[slab, i, j, lane] = 2.0 * to - before
    moved[part_index(slab, tile, j, lane, n_i, n_j, light.shape[3])] = result


@wp.kernel
def limit_step(
    ahead: Vectors, held: Vectors, target: Vectors, rows: Vectors, least: float, leak: float, loose: float,
    step: float, reach: float, wall: Vectors, cap: Vectors, wall_after: Vectors, cap_after: Vectors,
    inside: wp.array[float], outside: wp.array[float], moved: wp.array[float], crossed: wp.array[float],
    n_i: int, n_j: int, n_z: int, n_part: int,
) -> None:  # fmt: skip
    slab, tile, j, lane = wp.tid()
    count = real_lanes(slab, lane, wall.shape[3], n_z)
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
        before = wall[slab, i, j, lane]
        top = cap[slab, i, j, lane]
        to = wp.vec4(0.0, 0.0, 0.0, 0.0)
        most = wp.vec4(0.0, 0.0, 0.0, 0.0)
        for k in range(4):
            weight = float(1.0)
            if circle and row[k] > 0.0:
                weight = row[k]
            of_wall = weight + 1.0
            of_cap = weight
            least_share = float(1.0)
            top_share = float(0.0)
            on_leak = float(0.0)
            lower = least
            upper = float(1.0)
            if body[k] >= 1.5:
                share = body[k] - 2.0
                of_wall = weight + 1.5
                of_cap = weight + 1.5
                if share < loose:
                    lower = 0.5 * (1.0 - share + (2.0 - share) * least - leak)
                    least_share = 1.0 - 0.5 * share
                    upper = 0.5 * (1.0 + share + share * least + leak)
                    top_share = 0.5 * share
                    on_leak = 0.5
            if circle and row[k] > 0.0:
                excess = dose[k] - leak
                if body[k] >= 0.5:
                    excess = lower - dose[k]
                    most[k] = wp.max(0.0, top[k] + step * (dose[k] - upper) / of_cap)
                to[k] = wp.max(0.0, before[k] + step * excess / of_wall)
            if k < count:
                higher = to[k] - before[k]
                tighter = most[k] - top[k]
                change = higher
                if body[k] >= 0.5:
                    within += least_share * to[k] - top_share * most[k]
                    beyond += on_leak * (to[k] + most[k])
                    change = tighter - higher
                else:
                    beyond += to[k]
                far += of_wall * higher * higher + of_cap * tighter * tighter
                product += change * 0.5 * (dose[k] - past[k])
        wall_after[slab, i, j, lane] = to
        cap_after[slab, i, j, lane] = most
    part = part_index(slab, tile, j, lane, n_i, n_j, wall.shape[3])
    inside[part] = within
    outside[part] = beyond
    moved[part] = far
    crossed[part] = product


@wp.kernel
def price_dose(wall: Vectors, cap: Vectors, target: Vectors, pull: Vectors, n_i: int, n_j: int, n_z: int) -> None:
    slab, i, j, lane = wp.tid()
    price = wall[slab, i, j, lane]
    body = target[slab, i, j, lane]
    top = cap[slab, i, j, lane]
    for k in range(4):
        if body[k] >= 0.5:
            price[k] = top[k] - price[k]
    pull[slab, i, j, lane] = price


@wp.kernel
def reflect(step: Vectors, anchor: Vectors, share: float, now: Vectors, n_i: int, n_j: int, n_z: int) -> None:
    slab, i, j, lane = wp.tid()
    now[slab, i, j, lane] = (
        share * (2.0 * step[slab, i, j, lane] - now[slab, i, j, lane]) + (1.0 - share) * anchor[slab, i, j, lane]
    )

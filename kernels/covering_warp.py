"""Warp version of `covering`; a thread owns four lanes of z of one sample, or of a column of `ROWS` of them."""

from __future__ import annotations

from typing import Any

import warp as wp

from vamgpu.kernels.partial_warp import ROWS, disc_distance, part_index, real_lanes
from vamgpu.kernels.wide_warp import Vectors

wp.set_module_options({"enable_backward": False, "fast_math": False})

FAINT: Any = wp.constant(1e-9)
NEVER: Any = wp.constant(1e30)


@wp.kernel
def divide_prices(
    lower: Vectors, upper: Vectors, target: Vectors, inside: float, outside: float, paid: Vectors, cost: Vectors,
    n_i: int, n_j: int, n_z: int,
) -> None:  # fmt: skip
    slab, i, j, lane = wp.tid()
    price = lower[slab, i, j, lane]
    top = upper[slab, i, j, lane]
    body = target[slab, i, j, lane]
    gain = wp.vec4(0.0, 0.0, 0.0, 0.0)
    loss = wp.vec4(0.0, 0.0, 0.0, 0.0)
    for k in range(4):
        if body[k] >= 0.5:
            gain[k] = inside * wp.max(0.0, price[k])
            loss[k] = inside * wp.max(0.0, top[k])
        else:
            loss[k] = outside * wp.max(0.0, price[k])
    paid[slab, i, j, lane] = gain
    cost[slab, i, j, lane] = loss


@wp.kernel
def light_short_pixels(
    paid: Vectors, cost: Vectors, cover: Vectors, scale: float, light: Vectors, n_i: int, n_j: int, n_z: int
) -> None:
    slab, i, j, lane = wp.tid()
    lack = paid[slab, i, j, lane] - cost[slab, i, j, lane]
    covered = cover[slab, i, j, lane]
    before = light[slab, i, j, lane]
    to = wp.vec4(0.0, 0.0, 0.0, 0.0)
    for k in range(4):
        if lack[k] > 0.0:
            to[k] = 1.0
            if covered[k] > 0.0:
                share = lack[k] / (scale * covered[k])
                to[k] = wp.clamp(before[k] * share * share, FAINT, 1.0)
    light[slab, i, j, lane] = to


@wp.kernel
def level_cover(rows: Vectors, reach: float, cover: Vectors, n_i: int, n_j: int, n_z: int) -> None:
    slab, i, j, lane = wp.tid()
    circle = disc_distance(i, j, n_i, n_j) <= reach * reach
    row = rows[slab, i, j, lane]
    before = cover[slab, i, j, lane]
    to = wp.vec4(0.0, 0.0, 0.0, 0.0)
    for k in range(4):
        if circle and row[k] > 0.0:
            to[k] = before[k] / row[k]
    cover[slab, i, j, lane] = to


@wp.kernel
def cover_scale(
    paid: Vectors, cost: Vectors, cover: Vectors, keep: float, highs: wp.array[float],
    n_i: int, n_j: int, n_z: int, n_part: int,
) -> None:  # fmt: skip
    slab, tile, j, lane = wp.tid()
    count = real_lanes(slab, lane, paid.shape[3], n_z)
    most = float(0.0)
    for i in range(tile * ROWS, wp.min(tile * ROWS + ROWS, n_i)):
        lack = keep * paid[slab, i, j, lane] - cost[slab, i, j, lane]
        covered = cover[slab, i, j, lane]
        for k in range(count):
            if lack[k] > 0.0:
                scale = NEVER
                if covered[k] > 0.0:
                    scale = lack[k] / covered[k]
                most = wp.max(most, scale)
    highs[part_index(slab, tile, j, lane, n_i, n_j, paid.shape[3])] = most

"""Warp siblings of `split`; a thread owns four lanes of z of one sample, or of a column of `ROWS` of them."""

from __future__ import annotations

import warp as wp

from vamgpu.kernels.partial_warp import ROWS, disc_distance, part_index, real_lanes
from vamgpu.kernels.wide_warp import Vectors

wp.set_module_options({"enable_backward": False, "fast_math": False})


@wp.kernel
def split_levels(
    held: Vectors, owed: Vectors, target: Vectors, least: float, leak: float, reach: float, below: wp.array[float],
    shorts: wp.array[float], above: wp.array[float], over: wp.array[float], n_i: int, n_j: int, n_z: int, n_part: int,
) -> None:  # fmt: skip
    slab, tile, j, lane = wp.tid()
    count = real_lanes(slab, lane, held.shape[3], n_z)
    few = float(0.0)
    lacking = float(0.0)
    many = float(0.0)
    leaking = float(0.0)
    for i in range(tile * ROWS, wp.min(tile * ROWS + ROWS, n_i)):
        if disc_distance(i, j, n_i, n_j) <= reach * reach:
            dose = 2.0 * held[slab, i, j, lane] + owed[slab, i, j, lane]
            body = target[slab, i, j, lane]
            for k in range(4):
                if k < count:
                    lacks = least - wp.min(1.0, dose[k])
                    leaks = dose[k] - leak
                    if body[k] >= 0.5:
                        if lacks > 0.0:
                            few += 1.0
                            lacking += lacks
                    elif leaks > 0.0:
                        many += 1.0
                        leaking += leaks
    part = part_index(slab, tile, j, lane, n_i, n_j, held.shape[3])
    below[part] = few
    shorts[part] = lacking
    above[part] = many
    over[part] = leaking


@wp.kernel
def split_dose(
    held: Vectors, target: Vectors, least: float, leak: float, relax: float, reach: float, owed: Vectors,
    pull: Vectors, n_i: int, n_j: int, n_z: int,
) -> None:  # fmt: skip
    slab, i, j, lane = wp.tid()
    own = held[slab, i, j, lane]
    dose = 2.0 * own + owed[slab, i, j, lane]
    body = target[slab, i, j, lane]
    falls = wp.vec4(0.0, 0.0, 0.0, 0.0)
    rest = wp.vec4(0.0, 0.0, 0.0, 0.0)
    if disc_distance(i, j, n_i, n_j) <= reach * reach:
        for k in range(4):
            within = wp.min(leak, dose[k])
            if body[k] >= 0.5:
                within = wp.max(least, wp.min(1.0, dose[k]))
            beyond = relax * within + (1.0 - relax) * own[k]
            falls[k] = beyond - dose[k]
            rest[k] = dose[k] - own[k] - beyond
    pull[slab, i, j, lane] = falls
    owed[slab, i, j, lane] = rest


@wp.kernel
def split_light(
    light: Vectors, base: float, relax: float, owed: Vectors, pull: Vectors, n_i: int, n_j: int, n_z: int
) -> None:
    slab, i, j, lane = wp.tid()
    own = light[slab, i, j, lane]
    bright = 2.0 * own + owed[slab, i, j, lane]
    lit = bright
    for k in range(4):
        lit[k] = wp.max(0.0, bright[k])
    beyond = relax * lit + (1.0 - relax) * own
    pull[slab, i, j, lane] = pull[slab, i, j, lane] + base * (beyond - bright)
    owed[slab, i, j, lane] = bright - own - beyond


@wp.kernel
def split_prices(
    held: Vectors, owed: Vectors, target: Vectors, least: float, leak: float, reach: float, wall: Vectors,
    cap: Vectors, n_i: int, n_j: int, n_z: int,
) -> None:  # fmt: skip
    slab, i, j, lane = wp.tid()
    dose = 2.0 * held[slab, i, j, lane] + owed[slab, i, j, lane]
    body = target[slab, i, j, lane]
    price = wp.vec4(0.0, 0.0, 0.0, 0.0)
    top = wp.vec4(0.0, 0.0, 0.0, 0.0)
    if disc_distance(i, j, n_i, n_j) <= reach * reach:
        for k in range(4):
            if body[k] >= 0.5:
                price[k] = wp.max(0.0, least - dose[k])
                top[k] = wp.max(0.0, dose[k] - 1.0)
            else:
                price[k] = wp.max(0.0, dose[k] - leak)
    wall[slab, i, j, lane] = price
    cap[slab, i, j, lane] = top

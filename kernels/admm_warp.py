"""Warp version of `admm`; a thread owns four lanes of z of one sample, or of a column of `ROWS` of them."""

from __future__ import annotations

import warp as wp

from vamgpu.kernels.partial_warp import ROWS, disc_distance, part_index, real_lanes
from vamgpu.kernels.wide_warp import Vectors

wp.set_module_options({"enable_backward": False, "fast_math": False})


@wp.func
def counted(body: wp.vec4, i: int, j: int, n_i: int, n_j: int, reach: float, rim: float):
    """Weights of four voxels."""
    share = wp.vec4(1.0, 1.0, 1.0, 1.0)
    if disc_distance(i, j, n_i, n_j) > reach * reach:
        for k in range(4):
            share[k] = rim
            if body[k] >= 0.5:
                share[k] = 0.0
    return share


@wp.kernel
def find_levels(
    held: Vectors, scaled_dual: Vectors, target: Vectors, least: float, leak: float, reach: float, rim: float,
    below: wp.array[float], shorts: wp.array[float], above: wp.array[float], over: wp.array[float],
    n_i: int, n_j: int, n_z: int, n_part: int,
) -> None:  # fmt: skip
    slab, tile, j, lane = wp.tid()
    count = real_lanes(slab, lane, held.shape[3], n_z)
    few = float(0.0)
    lacking = float(0.0)
    many = float(0.0)
    leaking = float(0.0)
    for i in range(tile * ROWS, wp.min(tile * ROWS + ROWS, n_i)):
        dose = 2.0 * held[slab, i, j, lane] + scaled_dual[slab, i, j, lane]
        body = target[slab, i, j, lane]
        share = counted(body, i, j, n_i, n_j, reach, rim)
        for k in range(4):
            if k < count:
                lacks = least - wp.min(1.0, dose[k])
                leaks = dose[k] - leak
                if body[k] >= 0.5:
                    if lacks > 0.0:
                        few += share[k]
                        lacking += share[k] * lacks
                elif leaks > 0.0:
                    many += share[k]
                    leaking += share[k] * leaks
    part = part_index(slab, tile, j, lane, n_i, n_j, held.shape[3])
    below[part] = few
    shorts[part] = lacking
    above[part] = many
    over[part] = leaking


@wp.kernel
def clip_dose(
    held: Vectors, target: Vectors, least: float, leak: float, relax: float, reach: float, rim: float,
    scaled_dual: Vectors, pull: Vectors, n_i: int, n_j: int, n_z: int,
) -> None:  # fmt: skip
    slab, i, j, lane = wp.tid()
    own = held[slab, i, j, lane]
    dose = 2.0 * own + scaled_dual[slab, i, j, lane]
    body = target[slab, i, j, lane]
    within = dose
    for k in range(4):
        within[k] = wp.min(leak, dose[k])
        if body[k] >= 0.5:
            within[k] = wp.max(least, wp.min(1.0, dose[k]))
    beyond = relax * within + (1.0 - relax) * own
    pull[slab, i, j, lane] = wp.cw_mul(counted(body, i, j, n_i, n_j, reach, rim), beyond - dose)
    scaled_dual[slab, i, j, lane] = dose - own - beyond


@wp.kernel
def clip_light(
    light: Vectors, white: Vectors, push: float, base: float, relax: float, scaled_dual: Vectors, pull: Vectors,
    n_i: int, n_j: int, n_z: int,
) -> None:  # fmt: skip
    slab, i, j, lane = wp.tid()
    own = light[slab, i, j, lane]
    most = white[slab, i, j, lane]
    bright = 2.0 * own + scaled_dual[slab, i, j, lane]
    driven = bright + push * (bright - 0.5 * most)
    lit = driven
    for k in range(4):
        lit[k] = wp.min(most[k], wp.max(0.0, driven[k]))
    beyond = relax * lit + (1.0 - relax) * own
    pull[slab, i, j, lane] = pull[slab, i, j, lane] + base * (beyond - bright)
    scaled_dual[slab, i, j, lane] = bright - own - beyond

"""Warp version of `reduce`; a thread owns four lanes of a column of `ROWS` samples."""

from __future__ import annotations

import warp as wp

from vamgpu.kernels.partial_warp import ROWS, disc_distance, part_index, real_lanes
from vamgpu.kernels.wide_warp import Vectors

wp.set_module_options({"enable_backward": False, "fast_math": False})


@wp.kernel
def partial_sum(a: Vectors, parts: wp.array[float], n_i: int, n_j: int, n_z: int, n_part: int) -> None:
    slab, tile, j, lane = wp.tid()
    count = real_lanes(slab, lane, a.shape[3], n_z)
    result = float(0.0)
    for i in range(tile * ROWS, wp.min(tile * ROWS + ROWS, n_i)):
        value = a[slab, i, j, lane]
        for k in range(count):
            result += value[k]
    parts[part_index(slab, tile, j, lane, n_i, n_j, a.shape[3])] = result


@wp.kernel
def partial_dot(
    a: Vectors, b: Vectors, parts: wp.array[float],
    n_i: int, n_j: int, n_z: int, n_part: int,
) -> None:  # fmt: skip
    slab, tile, j, lane = wp.tid()
    count = real_lanes(slab, lane, a.shape[3], n_z)
    result = float(0.0)
    for i in range(tile * ROWS, wp.min(tile * ROWS + ROWS, n_i)):
        value = a[slab, i, j, lane]
        other = b[slab, i, j, lane]
        for k in range(count):
            result += value[k] * other[k]
    parts[part_index(slab, tile, j, lane, n_i, n_j, a.shape[3])] = result


@wp.kernel
def partial_extent(
    a: Vectors, mask: Vectors, lower: float, upper: float, reach: float, lows: wp.array[float],
    highs: wp.array[float],
    n_i: int, n_j: int, n_z: int, n_part: int,
) -> None:  # fmt: skip
    slab, tile, j, lane = wp.tid()
    count = real_lanes(slab, lane, a.shape[3], n_z)
    low = float(wp.inf)
    high = float(-wp.inf)
    for i in range(tile * ROWS, wp.min(tile * ROWS + ROWS, n_i)):
        if disc_distance(i, j, n_i, n_j) <= reach * reach:
            value = a[slab, i, j, lane]
            chosen_by = mask[slab, i, j, lane]
            for k in range(count):
                if chosen_by[k] >= lower and chosen_by[k] < upper:
                    low = wp.min(low, value[k])
                    high = wp.max(high, value[k])
    part = part_index(slab, tile, j, lane, n_i, n_j, a.shape[3])
    lows[part] = low
    highs[part] = high


@wp.kernel
def fold(parts: wp.array[float], kind: int, folded: wp.array[float], n_part: int, n_folded: int) -> None:
    k = wp.tid()
    result = float(0.0)
    if kind == 1:
        result = wp.inf
    if kind == 2:
        result = -wp.inf
    part = k
    while part < n_part:
        value = parts[part]
        if kind == 0:
            result += value
        elif kind == 1:
            result = wp.min(result, value)
        else:
            result = wp.max(result, value)
        part += n_folded
    folded[k] = result

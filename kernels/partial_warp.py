"""Partial results of Warp kernels: the number of an item's result, and the padding lanes."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False, "fast_math": False})

ROWS = 32  # the tiling that all kernels with partial results declare for GPUs


@wp.func
def part_index(slab: int, tile: int, j: int, lane: int, n_i: int, n_j: int, n_lane: int):
    tiles = (n_i + ROWS - 1) // ROWS
    return ((slab * tiles + tile) * n_j + j) * n_lane + lane


@wp.func
def real_lanes(slab: int, lane: int, n_lane: int, n_z: int):
    """The number of a thread's four lanes that are slices of the field."""
    return wp.clamp(n_z - 4 * (slab * n_lane + lane), 0, 4)


@wp.func
def disc_distance(i: int, j: int, n_i: int, n_j: int):
    a = float(i) - 0.5 * float(n_i - 1)
    b = float(j) - 0.5 * float(n_j - 1)
    return a * a + b * b

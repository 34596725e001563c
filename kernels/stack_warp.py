"""Warp version of `stack`."""

from __future__ import annotations

import warp as wp

from vamgpu.kernels.wide_warp import Vectors, slice_of

wp.set_module_options({"enable_backward": False, "fast_math": False})


@wp.kernel
def put_slices(
    source: Vectors, first: int, factor: float, keep: int, lanes: int, stack: Vectors,
    n_i: int, n_j: int, n_source: int, n_z: int,
) -> None:  # fmt: skip
    slab, i, j, lane = wp.tid()
    begin = 4 * (slab * stack.shape[3] + lane) - first
    if begin + 4 <= 0 or begin >= n_source:
        return
    held = stack[slab, i, j, lane]
    for k in range(4):
        s = begin + k
        if s >= 0 and s < n_source:
            value = factor * slice_of(source, i, j, s)
            if keep != 0:
                value += held[k]
            held[k] = value
    stack[slab, i, j, lane] = held

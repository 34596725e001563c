"""Warp version of `gather`; a thread owns four lanes of one row."""

from __future__ import annotations

import warp as wp

from vamgpu.kernels.wide_warp import Flat, read

wp.set_module_options({"enable_backward": False, "fast_math": False})


@wp.kernel
def gather_rows(
    source: Flat, first: wp.array[int], entries: wp.array2d[float], out: Flat,
    n_u: int, n_v: int, n_z: int, n_row: int, n_entry: int, n_i: int, n_j: int,
) -> None:  # fmt: skip
    slab, i, j, lane = wp.tid()
    lanes = source.shape[1] // (n_u * n_v)
    blocks = (n_row - 1) // (n_i * n_j)
    total = wp.vec4(0.0, 0.0, 0.0, 0.0)
    for block in range(blocks):
        row = (i * blocks + block) * n_j + j
        for k in range(first[row], first[row + 1]):
            total += entries[k, 1] * read(source, slab, int(entries[k, 0]) * lanes + lane)
    out[slab, (i * n_j + j) * lanes + lane] = total

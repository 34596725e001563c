"""Warp version of `shift`."""

from __future__ import annotations

import warp as wp

from vamgpu.kernels.wide_warp import Vectors, slice_of

wp.set_module_options({"enable_backward": False, "fast_math": False})


@wp.kernel
def shift_images(
    source: Vectors, moves: wp.array2d[float], tapers: wp.array2d[float], after: int, lanes: int,
    moved: Vectors,
    n_image: int, n_column: int, n_row: int, n_move: int, n_tile: int, n_taper: int, n_angle: int, n_r: int, n_z: int,
) -> None:  # fmt: skip
    slab, angle, r, lane = wp.tid()
    result = wp.vec4(0.0, 0.0, 0.0, 0.0)
    for which in range(4):
        z = 4 * (slab * moved.shape[3] + lane) + which
        total = float(0.0)
        if z < n_z:
            for k in range(angle, n_move, n_angle):
                first_r = r + int(moves[k, 0])
                first_z = z + int(moves[k, 2])
                taper = int(wp.int64(k) * wp.int64(n_tile) / wp.int64(n_move))
                for corner in range(4):
                    column = first_r + corner // 2
                    row = first_z + corner % 2
                    if column >= 0 and column < n_column and row >= 0 and row < n_row:
                        share = wp.abs(float(first_r + 1 - column) - moves[k, 1])
                        share = share * wp.abs(float(first_z + 1 - row) - moves[k, 3])
                        own = row
                        if after != 0:
                            own = z
                        total += share * tapers[taper, own] * slice_of(source, k % n_image, column, row)
        result[which] = total
    moved[slab, angle, r, lane] = result

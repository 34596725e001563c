"""Warp version of `vamgpu.kernels.photon_bins`."""

import warp as wp


@wp.kernel
def sum_bins(
    tally: wp.array4d[wp.uint32], factor: wp.array[float], basis: wp.array2d[float], whole: wp.array2d[float],
    light: wp.array3d[float], n_column: int, n_cell: int, n_bin: int, n_term: int,
) -> None:  # fmt: skip
    column, cell = wp.tid()
    total = float(0.0)
    for term in range(n_term):
        light[column, cell, term] = 0.0
    for b in range(n_bin):
        low = tally[column, cell, b, 0]
        high = tally[column, cell, b, 1]
        if low != wp.uint32(0) or high != wp.uint32(0):
            tally[column, cell, b, 0] = wp.uint32(0)
            tally[column, cell, b, 1] = wp.uint32(0)
            value = (float(high) * 4294967296.0 + float(low)) * factor[cell]
            total += value
            for term in range(n_term):
                light[column, cell, term] = light[column, cell, term] + basis[b, term] * value
    whole[column, cell] = total

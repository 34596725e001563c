"""Warp version of `watch`; a thread owns four lanes of z of one voxel's column, or one picked voxel."""

from __future__ import annotations

import warp as wp

from vamgpu.kernels.wide_warp import Vectors, slice_of

wp.set_module_options({"enable_backward": False, "fast_math": False})


@wp.kernel
def pick_voxels(
    field: Vectors, places: wp.array2d[int], picked: wp.array[float], n_i: int, n_j: int, n_z: int, n_pick: int
) -> None:
    k = wp.tid()
    picked[k] = slice_of(field, places[k, 0], places[k, 1], places[k, 2])


@wp.kernel
def interpolate(
    x: Vectors, knots: wp.array[float], values: wp.array[float], out: Vectors, n_i: int, n_j: int, n_z: int, n_knot: int
) -> None:
    slab, i, j, lane = wp.tid()
    place = x[slab, i, j, lane]
    found = wp.vec4(values[0], values[0], values[0], values[0])
    for k in range(n_knot - 1):
        length = knots[k + 1] - knots[k]
        slope = (values[k + 1] - values[k]) / length
        for m in range(4):
            found[m] = found[m] + slope * wp.clamp(place[m] - knots[k], 0.0, length)
    out[slab, i, j, lane] = found


@wp.kernel
def conversion_deviation(
    extinction: Vectors, sharp: Vectors, rounded: Vectors, knots: wp.array[float], slopes: wp.array[float],
    model: float, variance: Vectors, n_i: int, n_j: int, n_z: int, n_knot: int,
) -> None:  # fmt: skip
    slab, i, j, lane = wp.tid()
    place = extinction[slab, i, j, lane]
    edge = sharp[slab, i, j, lane] - rounded[slab, i, j, lane]
    found = variance[slab, i, j, lane]
    for m in range(4):
        slope = slopes[0]
        for k in range(1, n_knot):
            if place[m] >= knots[k]:
                slope = slopes[k]
        found[m] = wp.sqrt(found[m] * slope * slope + 4.0 * edge[m] * edge[m] + model * model)
    variance[slab, i, j, lane] = found

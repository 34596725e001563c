"""Warp version of `traced`; a thread marches the rays of one pixel at one angle."""

from __future__ import annotations

import warp as wp

from vamgpu.kernels.medium_warp import BLOCKS, DARK, MARGIN, Samples, advance, at_node, enter
from vamgpu.kernels.wide_warp import Flat

wp.set_module_options({"enable_backward": False, "fast_math": False})


@wp.func_native("""
    return *((const float*)((const char*)field.data + (size_t)slab * field.strides[0]) + index);
""")
def one(field: Flat, slab: int, index: int) -> float:  # type: ignore[empty-body]
    """One lane of a field."""
    ...


@wp.func_native("""
    *((float*)((char*)field.data + (size_t)slab * field.strides[0]) + index) = value;
""")
def put(field: Flat, slab: int, index: int, value: float): ...


@wp.func_native("""
    float* at = (float*)((char*)field.data + (size_t)slab * field.strides[0]) + index;
#if defined(__CUDA_ARCH__)
    atomicAdd(at, value);
#else
    *at += value;
#endif
""")
def add(field: Flat, slab: int, index: int, value: float):
    """Adds to one lane atomically, because rays cross and voxels have no owner."""
    ...


@wp.func
def beside(middle: wp.vec3, corner: int):
    """One of the eight voxels beside a point."""
    x, y, z = int(wp.floor(middle[0])), int(wp.floor(middle[1])), int(wp.floor(middle[2]))
    return wp.vec3i(x + corner // 4, y + (corner // 2) % 2, z + corner % 2)


@wp.func
def share_of(medium: Samples, at: wp.vec3i, n_x: int, n_y: int, n_z: int, middle: wp.vec3, kind: int):
    """Weight of a voxel beside a point; none beyond the grid and in inserts."""
    x, y, z = at[0], at[1], at[2]
    if x < 0 or y < 0 or z < 0 or x >= n_x or y >= n_y or z >= n_z:
        return 0.0
    if (kind & BLOCKS) != 0:
        k = int(0)
        if medium.shape[2] > 1:
            k = z + MARGIN
        if at_node(medium, x + MARGIN, y + MARGIN, k)[3] <= -DARK:
            return 0.0
    return (
        (1.0 - wp.abs(middle[0] - float(x)))
        * (1.0 - wp.abs(middle[1] - float(y)))
        * (1.0 - wp.abs(middle[2] - float(z)))
    )


@wp.kernel
def forward_traced(
    volume: Flat, medium: Samples, starts: wp.array2d[float], directions: wp.array2d[float],
    steps: wp.array2d[int], step: float, kind: int, lanes: int, sinogram: Flat,
    n_x: int, n_y: int, n_z: int, n_p: int, n_q: int, n_s: int, n_ray: int, n_angle: int, n_pixel: int, n_r: int,
    n_row: int,
) -> None:  # fmt: skip
    angle, pixel = wp.tid()
    wide = 4 * (volume.shape[1] // (n_x * n_y))
    bundle = n_ray // n_pixel
    top = float(n_z) + 1.0
    total = float(0.0)
    for b in range(bundle):
        ray = enter(medium, starts, pixel * bundle + b, directions, angle, top)
        taken = int(0)
        while taken < steps[angle, pixel] and ray.on == 1:
            ray = advance(medium, ray, top, step, kind)
            taken += 1
            met = float(0.0)
            for corner in range(8):
                at = beside(ray.middle, corner)
                share = share_of(medium, at, n_x, n_y, n_z, ray.middle, kind)
                if share > 0.0:
                    met += share * one(volume, at[2] // wide, (at[0] * n_y + at[1]) * wide + at[2] % wide)
            total += ray.weight * met
    r = pixel // n_row
    row = pixel % n_row
    put(sinogram, row // lanes, (angle * n_r + r) * lanes + row % lanes, total)


@wp.kernel
def back_traced(
    sinogram: Flat, medium: Samples, starts: wp.array2d[float], directions: wp.array2d[float],
    steps: wp.array2d[int], step: float, kind: int, lanes: int, volume: Flat,
    n_angle: int, n_r: int, n_row: int, n_p: int, n_q: int, n_s: int, n_ray: int, n_pixel: int, n_x: int, n_y: int,
    n_z: int,
) -> None:  # fmt: skip
    angle, pixel = wp.tid()
    wide = 4 * (volume.shape[1] // (n_x * n_y))
    bundle = n_ray // n_pixel
    top = float(n_z) + 1.0
    r = pixel // n_row
    row = pixel % n_row
    light = one(sinogram, row // lanes, (angle * n_r + r) * lanes + row % lanes)
    for b in range(bundle):
        ray = enter(medium, starts, pixel * bundle + b, directions, angle, top)
        taken = int(0)
        while taken < steps[angle, pixel] and ray.on == 1:
            ray = advance(medium, ray, top, step, kind)
            taken += 1
            for corner in range(8):
                at = beside(ray.middle, corner)
                share = share_of(medium, at, n_x, n_y, n_z, ray.middle, kind)
                if share * ray.weight > 0.0:
                    add(volume, at[2] // wide, (at[0] * n_y + at[1]) * wide + at[2] % wide, share * ray.weight * light)

"""Warp siblings of `refract`; a thread owns four lanes in each of four slabs of one sample.

A look-up costs as much as the lanes it serves, hence the four slabs; fields come flat per slab."""

from __future__ import annotations

import warp as wp

from vamgpu.kernels.wide_warp import read

wp.set_module_options({"enable_backward": False, "fast_math": False})


@wp.func_native("""
    const char* at = (const char*)light.data + (size_t)i * light.strides[0] + (size_t)j * 8;
#if defined(__CUDA_ARCH__)
    const float2 pair = *(const float2*)at;
    return wp::vec2(pair.x, pair.y);
#else
    return *(const wp::vec2*)at;
#endif
""")
def node(light: wp.array3d(dtype=float), i: int, j: int) -> wp.vec2:  # type: ignore[empty-body]
    """Column and weight at a sample of the map, in one load."""
    ...


@wp.func
def look_up(light: wp.array3d(dtype=float), n_across: int, n_along: int, c: float, s: float, x: float, y: float):
    across = y * c - x * s + 0.5 * float(n_across - 1)
    along = -x * c - y * s + 0.5 * float(n_along - 1)
    i = wp.clamp(int(across), 0, n_across - 2)
    j = wp.clamp(int(along), 0, n_along - 2)
    a = across - float(i)
    b = along - float(j)
    near = node(light, i, j)
    far = node(light, i + 1, j)
    near += b * (node(light, i, j + 1) - near)
    far += b * (node(light, i + 1, j + 1) - far)
    return near + a * (far - near)


@wp.func
def overlap(distance: float, reach: float, inverse: float):
    """How much of a voxel, 2 reach - 1 = 1 / inverse columns wide, lies in a column that far from it."""
    return wp.clamp(reach - wp.abs(distance), 0.0, 1.0) * inverse


@wp.kernel(launch_bounds=(256, 3))  # fewer registers, so that more threads hide the loads
def back_refracted(
    sinogram: wp.array2d(dtype=wp.vec4),
    directions: wp.array2d(dtype=float),
    light: wp.array3d(dtype=float),
    width: float,
    radius: float,
    volume: wp.array2d(dtype=wp.vec4),
    n_angle: int,
    n_r: int,
    n_z: int,
    n_across: int,
    n_along: int,
    n_x: int,
    n_y: int,
):
    block, i, j, lane = wp.tid()
    s0 = 4 * block
    s1 = wp.min(s0 + 1, volume.shape[0] - 1)  # the last thread's surplus slabs repeat the last one there is
    s2 = wp.min(s0 + 2, volume.shape[0] - 1)
    s3 = wp.min(s0 + 3, volume.shape[0] - 1)
    lanes = volume.shape[1] // (n_x * n_y)
    x = float(i) - 0.5 * float(n_x - 1)
    y = float(j) - 0.5 * float(n_y - 1)
    t0 = wp.vec4(0.0, 0.0, 0.0, 0.0)
    t1 = wp.vec4(0.0, 0.0, 0.0, 0.0)
    t2 = wp.vec4(0.0, 0.0, 0.0, 0.0)
    t3 = wp.vec4(0.0, 0.0, 0.0, 0.0)
    if x * x + y * y <= radius * radius:
        inverse = 1.0 / width
        reach = 0.5 * (1.0 + width)
        taps = int(wp.ceil(2.0 * reach))
        for angle in range(n_angle):
            pose = angle * n_r * lanes + lane
            ray = look_up(light, n_across, n_along, directions[angle, 0], directions[angle, 1], x, y)
            first = int(wp.ceil(ray[0] - reach))
            for tap in range(wp.max(first, 0), wp.min(first + taps, n_r)):
                weight = ray[1] * overlap(ray[0] - float(tap), reach, inverse)
                index = pose + tap * lanes
                t0 += weight * read(sinogram, s0, index)
                t1 += weight * read(sinogram, s1, index)
                t2 += weight * read(sinogram, s2, index)
                t3 += weight * read(sinogram, s3, index)
    index = (i * n_y + j) * lanes + lane
    volume[s0, index] = t0
    volume[s1, index] = t1
    volume[s2, index] = t2
    volume[s3, index] = t3


@wp.func
def line(
    p: float, cos_d: float, sin_d: float, c0: float, s0: float, along_y: int, planes_middle: float, cells_middle: float
):
    c = c0 * cos_d - s0 * sin_d
    s = s0 * cos_d + c0 * sin_d
    if along_y == 1:
        return wp.vec2(-p / s - planes_middle * c / s + cells_middle, c / s)
    return wp.vec2(p / c - planes_middle * s / c + cells_middle, s / c)


@wp.kernel(launch_bounds=(256, 3))  # fewer registers, so that more threads hide the loads
def forward_refracted(
    volume: wp.array2d(dtype=wp.vec4),
    directions: wp.array2d(dtype=float),
    light: wp.array3d(dtype=float),
    edges: wp.array2d(dtype=float),
    width: float,
    radius: float,
    sinogram: wp.array2d(dtype=wp.vec4),
    n_x: int,
    n_y: int,
    n_z: int,
    n_angle: int,
    n_across: int,
    n_along: int,
    n_r: int,
):
    block, angle, r, lane = wp.tid()
    s0 = 4 * block
    s1 = wp.min(s0 + 1, volume.shape[0] - 1)
    s2 = wp.min(s0 + 2, volume.shape[0] - 1)
    s3 = wp.min(s0 + 3, volume.shape[0] - 1)
    lanes = volume.shape[1] // (n_x * n_y)
    x0 = 0.5 * float(n_x - 1)
    y0 = 0.5 * float(n_y - 1)
    inverse = 1.0 / width
    reach = 0.5 * (1.0 + width)
    c = directions[angle, 0]
    s = directions[angle, 1]
    along_y = int(0)
    planes = n_x
    cells = n_y
    planes_middle = x0
    cells_middle = y0
    # the chord's own direction decides which planes it crosses most steeply
    if wp.abs(s * edges[r, 1] + c * edges[r, 2]) > wp.abs(c * edges[r, 1] - s * edges[r, 2]):
        along_y = int(1)
        planes = n_y
        cells = n_x
        planes_middle = y0
        cells_middle = x0
    low = line(edges[r, 0], edges[r, 1], edges[r, 2], c, s, along_y, planes_middle, cells_middle)
    high = line(edges[r, 4], edges[r, 5], edges[r, 6], c, s, along_y, planes_middle, cells_middle)
    t0 = wp.vec4(0.0, 0.0, 0.0, 0.0)
    t1 = wp.vec4(0.0, 0.0, 0.0, 0.0)
    t2 = wp.vec4(0.0, 0.0, 0.0, 0.0)
    t3 = wp.vec4(0.0, 0.0, 0.0, 0.0)
    for plane in range(planes):
        a = low[0] + float(plane) * low[1]
        b = high[0] + float(plane) * high[1]
        begin = wp.max(int(wp.ceil(wp.min(a, b) - edges[r, 3])), 0)
        end = wp.min(int(wp.floor(wp.max(a, b) + edges[r, 3])), cells - 1)
        for cell in range(begin, end + 1):
            i = plane
            j = cell
            if along_y == 1:
                i = cell
                j = plane
            x = float(i) - x0
            y = float(j) - y0
            if x * x + y * y <= radius * radius:
                ray = look_up(light, n_across, n_along, c, s, x, y)
                weight = ray[1] * overlap(ray[0] - float(r), reach, inverse)
                if weight > 0.0:
                    index = (i * n_y + j) * lanes + lane
                    t0 += weight * read(volume, s0, index)
                    t1 += weight * read(volume, s1, index)
                    t2 += weight * read(volume, s2, index)
                    t3 += weight * read(volume, s3, index)
    at = (angle * n_r + r) * lanes + lane
    sinogram[s0, at] = t0
    sinogram[s1, at] = t1
    sinogram[s2, at] = t2
    sinogram[s3, at] = t3

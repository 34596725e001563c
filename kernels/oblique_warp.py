"""Warp version of `oblique`; a thread owns four lanes of one sample."""

from __future__ import annotations

import warp as wp

from vamgpu.kernels.light_warp import cells_of, sampled, span_of
from vamgpu.kernels.wide_warp import Vectors, slice_of

wp.set_module_options({"enable_backward": False, "fast_math": False})


@wp.func
def overlap(distance: float, reach: float, inverse: float):
    """The part of a voxel, 2 reach - 1 = 1 / inverse columns wide, in a column at that distance from it."""
    return wp.clamp(reach - wp.abs(distance), 0.0, 1.0) * inverse


@wp.func
def look_up(light: wp.array3d[float], pose: wp.vec4, x: float, y: float):
    """Column index, weight, row of slice 0 and rows per slice of the light at a voxel, relative to the axis."""
    return sampled(light, y * pose[0] - x * pose[1] + pose[2], -x * pose[0] - y * pose[1] + pose[3])


@wp.func
def pose_of(poses: wp.array2d[float], angle: int):
    return wp.vec4(poses[angle, 0], poses[angle, 1], poses[angle, 2], poses[angle, 3])


@wp.func
def even(stretch: float):
    """Height in rows of slices a number of rows apart: whole multiples of that divide every row evenly."""
    return stretch * wp.max(1.0, wp.floor(1.0 / stretch + 0.5))


@wp.func
def row_of(ray: wp.vec4, z: float, row0: float):
    """Position of a slice among the rows, z counted from the middle; the same sum in both directions."""
    return z * ray[3] + (ray[2] + row0)


@wp.kernel
def back_oblique(
    sinogram: Vectors, poses: wp.array2d[float], light: wp.array3d[float], width: float, radius: float,
    lanes: int, volume: Vectors,
    n_angle: int, n_r: int, n_row: int, n_across: int, n_along: int, n_x: int, n_y: int, n_z: int,
) -> None:  # fmt: skip
    slab, i, j, lane = wp.tid()
    x = float(i) - 0.5 * float(n_x - 1)
    y = float(j) - 0.5 * float(n_y - 1)
    reach = 0.5 * (1.0 + width)
    taps = int(wp.ceil(2.0 * reach))
    first_z = float(4 * (slab * volume.shape[3] + lane)) - 0.5 * float(n_z - 1)
    row0 = 0.5 * float(n_row - 1)
    total = wp.vec4(0.0, 0.0, 0.0, 0.0)
    if x * x + y * y <= radius * radius:
        for angle in range(n_angle):
            ray = look_up(light, pose_of(poses, angle), x, y)
            first = int(wp.ceil(ray[0] - reach))
            reach_z = 0.5 * (1.0 + even(ray[3]))
            taps_z = int(wp.ceil(2.0 * reach_z))
            for tap in range(wp.max(first, 0), wp.min(first + taps, n_r)):
                weight = ray[1] * overlap(ray[0] - float(tap), reach, 1.0 / width) / even(ray[3])
                for k in range(4):
                    position = row_of(ray, first_z + float(k), row0)
                    place = int(wp.ceil(position - reach_z))
                    for row in range(wp.max(place, 0), wp.min(place + taps_z, n_row)):
                        apart = position - float(row)
                        share = weight * wp.clamp(reach_z - wp.abs(apart), 0.0, wp.min(1.0, even(ray[3])))
                        total[k] = total[k] + share * slice_of(sinogram, angle, tap, row)
    volume[slab, i, j, lane] = total


@wp.kernel
def forward_oblique(
    volume: Vectors, poses: wp.array2d[float], light: wp.array3d[float], edges: wp.array2d[float],
    width: float, radius: float, lanes: int, sinogram: Vectors,
    n_x: int, n_y: int, n_slice: int, n_angle: int, n_across: int, n_along: int, n_r: int, n_z: int,
) -> None:  # fmt: skip
    slab, angle, r, lane = wp.tid()
    x0 = 0.5 * float(n_x - 1)
    y0 = 0.5 * float(n_y - 1)
    z0 = 0.5 * float(n_slice - 1)
    reach = 0.5 * (1.0 + width)
    first_row = 4 * (slab * sinogram.shape[3] + lane)
    row0 = 0.5 * float(n_z - 1)
    pose = pose_of(poses, angle)
    span = span_of(edges, r, r, pose, n_x, n_y)
    total = wp.vec4(0.0, 0.0, 0.0, 0.0)
    for plane in range(span.planes):
        window = cells_of(span, plane)
        for cell in range(window[0], window[1] + 1):
            i = wp.where(span.along_y == 1, cell, plane)
            j = wp.where(span.along_y == 1, plane, cell)
            x = float(i) - x0
            y = float(j) - y0
            if x * x + y * y <= radius * radius:
                ray = look_up(light, pose, x, y)
                weight = ray[1] * overlap(ray[0] - float(r), reach, 1.0 / width) / even(ray[3])
                if weight != 0.0:
                    reach_z = 0.5 * (1.0 + even(ray[3]))
                    for k in range(4):
                        row = float(first_row + k)
                        middle = (row - row0 - ray[2]) / ray[3] + z0
                        apart_z = reach_z / ray[3]
                        from_z = wp.max(int(wp.floor(middle - apart_z)), 0)
                        to_z = wp.min(int(wp.ceil(middle + apart_z)), n_slice - 1)
                        for z in range(from_z, to_z + 1):
                            apart = row_of(ray, float(z) - z0, row0) - row
                            share = weight * wp.clamp(reach_z - wp.abs(apart), 0.0, wp.min(1.0, even(ray[3])))
                            total[k] = total[k] + share * slice_of(volume, i, j, z)
    sinogram[slab, angle, r, lane] = total

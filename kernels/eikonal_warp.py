"""Warp version of `eikonal`; a thread marches one ray."""

from __future__ import annotations

import warp as wp

from vamgpu.kernels.index_field_warp import FORMULA, PLANE, VOLUME, Medium, look

wp.set_module_options({"enable_backward": False, "fast_math": False})

OUTER = 1.3512071919596578
INNER = -1.7024143839193153
SHORTEN = 5
NEVER = -1.0e30


@wp.struct
class Ray:
    place: wp.vec3
    heading: wp.vec3
    pull: wp.vec3
    square: float


@wp.func
def ray_at(medium: Medium, place: wp.vec3, heading: wp.vec3):
    here = look(medium, place)
    ray = Ray()
    ray.place = place
    ray.heading = heading
    ray.pull = wp.vec3(here[0], here[1], here[2])
    ray.square = here[3]
    return ray


@wp.func
def pull_at(medium: Medium, place: wp.vec3):
    here = look(medium, place)
    return wp.vec3(here[0], here[1], here[2])


@wp.func
def leap(medium: Medium, ray: Ray, h: float):
    half_way = ray.heading + 0.5 * h * ray.pull
    end = ray_at(medium, ray.place + h * half_way, half_way)
    end.heading = half_way + 0.5 * h * end.pull
    return end


@wp.func
def advance(medium: Medium, ray: Ray, h: float, scheme: int):
    if scheme == 1:
        return leap(medium, ray, h)
    if scheme == 2:
        first = leap(medium, ray, OUTER * h)
        second = leap(medium, first, INNER * h)
        return leap(medium, second, OUTER * h)
    a = ray.pull
    b = pull_at(medium, ray.place + h * (0.5 * ray.heading + 0.125 * h * a))
    c = pull_at(medium, ray.place + h * (ray.heading + 0.5 * h * b))
    place = ray.place + h * (ray.heading + h / 6.0 * (a + 2.0 * b))
    return ray_at(medium, place, ray.heading + h / 6.0 * (a + 4.0 * b + c))


@wp.func
def way_of(ray: Ray, end: Ray, h: float):
    first = wp.dot(ray.pull, ray.heading)
    last = wp.dot(end.pull, end.heading)
    n0 = wp.sqrt(ray.square)
    n1 = wp.sqrt(end.square)
    optical = h * (0.5 * (ray.square + end.square) + h / 6.0 * (first - last))
    return wp.vec2(optical, h * (0.5 * (n0 + n1) + h / 12.0 * (first / n0 - last / n1)))


@wp.func
def outside(region: wp.array1d[float], ray: Ray):
    weighted = wp.vec3(region[0] * ray.place[0], region[1] * ray.place[1], region[2] * ray.place[2])
    growth = 2.0 * wp.dot(weighted, ray.heading)
    worst = float(NEVER)
    if growth > 0.0:
        worst = wp.dot(weighted, ray.place) - region[3]
    for axis in range(3):
        value = region[4 + axis] - ray.place[axis]
        if ray.heading[axis] > 0.0:
            value = ray.place[axis] - region[7 + axis]
        if ray.heading[axis] != 0.0 and value > worst:
            worst = value
            growth = wp.abs(ray.heading[axis])
    return wp.vec2(worst, growth)


@wp.func
def run(
    medium: Medium, starts: wp.array2d[float], region: wp.array1d[float], step: float, steps: int,
    scheme: int, every: int, ends: wp.array2d[float], path: wp.array3d[float],
    times: wp.array1d[float], index: int, n_row: int,
):  # fmt: skip
    place = wp.vec3(starts[index, 0], starts[index, 1], starts[index, 2])
    ray = ray_at(medium, place, wp.vec3(starts[index, 3], starts[index, 4], starts[index, 5]))
    way = wp.vec2(0.0, 0.0)
    rest = wp.vec2(0.0, 0.0)
    taken = int(0)
    row = int(1)
    left = int(0)
    for axis in range(3):
        path[index, 0, axis] = place[axis]
    while taken < steps and left == 0:
        end = advance(medium, ray, step, scheme)
        beyond = outside(region, end)
        if beyond[0] > 0.0:
            left = 1
        else:
            increment = way_of(ray, end, step) - rest
            total = way + increment
            rest = (total - way) - increment
            way = total
            ray = end
            taken += 1
            if taken == row * every and row < n_row:
                for axis in range(3):
                    path[index, row, axis] = ray.place[axis]
                row += 1
    time = float(-1.0)
    if left == 1:
        h = float(step)
        for _ in range(SHORTEN):
            beyond = outside(region, advance(medium, ray, h, scheme))
            if beyond[0] > 0.99 * NEVER:
                h = wp.clamp(h - beyond[0] / wp.max(beyond[1], 1.0e-30), 0.0, step)
        end = advance(medium, ray, h, scheme)
        way += way_of(ray, end, h)
        ray = end
        time = float(taken) * step + h
    for axis in range(3):
        for after in range(row, n_row):
            path[index, after, axis] = ray.place[axis]
        ends[index, axis] = ray.place[axis]
        ends[index, 3 + axis] = ray.heading[axis]
    ends[index, 6] = way[0]
    ends[index, 7] = way[1]
    times[index] = time


@wp.kernel
def march_formula(
    starts: wp.array2d[float], formula: wp.array1d[float], region: wp.array1d[float], step: float,
    steps: int, scheme: int, every: int, ends: wp.array2d[float], path: wp.array3d[float],
    times: wp.array1d[float],
    n_ray: int, n_row: int,
) -> None:  # fmt: skip
    medium = Medium()
    medium.kind = FORMULA
    medium.formula = formula
    run(medium, starts, region, step, steps, scheme, every, ends, path, times, wp.tid(), n_row)


@wp.kernel
def march_plane(
    starts: wp.array2d[float], coefficients: wp.array2d[float], corner: wp.array1d[float],
    region: wp.array1d[float], step: float, steps: int, scheme: int, every: int, ends: wp.array2d[float],
    path: wp.array3d[float], times: wp.array1d[float],
    n_ray: int, n_i: int, n_j: int, n_row: int,
) -> None:  # fmt: skip
    medium = Medium()
    medium.kind = PLANE
    medium.plane = coefficients
    medium.corner = wp.vec4(corner[0], corner[1], corner[2], corner[3])
    run(medium, starts, region, step, steps, scheme, every, ends, path, times, wp.tid(), n_row)


@wp.kernel
def march_volume(
    starts: wp.array2d[float], coefficients: wp.array3d[float], corner: wp.array1d[float],
    region: wp.array1d[float], step: float, steps: int, scheme: int, every: int, ends: wp.array2d[float],
    path: wp.array3d[float], times: wp.array1d[float],
    n_ray: int, n_i: int, n_j: int, n_k: int, n_row: int,
) -> None:  # fmt: skip
    medium = Medium()
    medium.kind = VOLUME
    medium.volume = coefficients
    medium.corner = wp.vec4(corner[0], corner[1], corner[2], corner[3])
    run(medium, starts, region, step, steps, scheme, every, ends, path, times, wp.tid(), n_row)

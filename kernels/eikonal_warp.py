"""Warp sibling of `eikonal`: one thread a ray. Kernels say which kind their medium is: compilers drop the rest."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False, "fast_math": False})

OUTER = wp.constant(1.3512071919596578)
INNER = wp.constant(-1.7024143839193153)
SHORTEN = wp.constant(5)
NEVER = wp.constant(-1.0e30)
FORMULA = wp.constant(0)
PLANE = wp.constant(1)
VOLUME = wp.constant(2)


@wp.struct
class Medium:
    kind: int
    formula: wp.array1d(dtype=float)
    plane: wp.array2d(dtype=float)
    volume: wp.array3d(dtype=float)
    corner: wp.vec4


@wp.struct
class Ray:
    place: wp.vec3
    heading: wp.vec3
    pull: wp.vec3
    square: float


@wp.func
def look_formula(formula: wp.array1d(dtype=float), at: wp.vec3):
    weighted = wp.vec3(formula[0] * at[0], formula[1] * at[1], formula[2] * at[2])
    s = wp.dot(weighted, at)
    above = formula[3] + s * (formula[4] + s * (formula[5] + s * formula[6]))
    below = formula[7] + s * (formula[8] + s * (formula[9] + s * formula[10]))
    up = formula[4] + s * (2.0 * formula[5] + 3.0 * s * formula[6])
    down = formula[8] + s * (2.0 * formula[9] + 3.0 * s * formula[10])
    square = above / below
    pull = (up - square * down) / below * weighted
    return wp.vec4(pull[0], pull[1], pull[2], square)


@wp.func
def weights_of(f: float):
    g = 1.0 - f
    return wp.vec4(g * g * g, 4.0 - 3.0 * f * f * (1.0 + g), 4.0 - 3.0 * g * g * (1.0 + f), f * f * f) / 6.0


@wp.func
def slopes_of(f: float):
    g = 1.0 - f
    return 0.5 * wp.vec4(-g * g, f * (3.0 * f - 4.0), g * (4.0 - 3.0 * g), f * f)


@wp.func
def cell_of(position: float, corners: int):
    return int(wp.clamp(position, 0.0, float(corners - 4)))


@wp.func
def into(position: float, cell: int):
    return wp.clamp(position - float(cell), -2.0, 3.0)


@wp.func
def look_plane(coefficients: wp.array2d(dtype=float), corner: wp.vec4, at: wp.vec3):
    x = (at[0] - corner[0]) * corner[3]
    y = (at[1] - corner[1]) * corner[3]
    i = cell_of(x, coefficients.shape[0])
    j = cell_of(y, coefficients.shape[1])
    wx = weights_of(into(x, i))
    dx = slopes_of(into(x, i))
    wy = weights_of(into(y, j))
    dy = slopes_of(into(y, j))
    result = wp.vec3(0.0, 0.0, 0.0)
    for a in range(4):
        row = wp.vec4(coefficients[i + a, j], coefficients[i + a, j + 1], coefficients[i + a, j + 2],
                      coefficients[i + a, j + 3])  # fmt: skip
        even = wp.dot(row, wy)
        result += wp.vec3(dx[a] * even, wx[a] * wp.dot(row, dy), wx[a] * even)
    scale = 0.5 * corner[3]
    return wp.vec4(scale * result[0], scale * result[1], 0.0, result[2])


@wp.func
def look_volume(coefficients: wp.array3d(dtype=float), corner: wp.vec4, at: wp.vec3):
    x = (at[0] - corner[0]) * corner[3]
    y = (at[1] - corner[1]) * corner[3]
    z = (at[2] - corner[2]) * corner[3]
    i = cell_of(x, coefficients.shape[0])
    j = cell_of(y, coefficients.shape[1])
    k = cell_of(z, coefficients.shape[2])
    wx = weights_of(into(x, i))
    dx = slopes_of(into(x, i))
    wy = weights_of(into(y, j))
    dy = slopes_of(into(y, j))
    wz = weights_of(into(z, k))
    dz = slopes_of(into(z, k))
    result = wp.vec4(0.0, 0.0, 0.0, 0.0)
    for a in range(4):
        for b in range(4):
            p = i + a
            q = j + b
            row = wp.vec4(coefficients[p, q, k], coefficients[p, q, k + 1], coefficients[p, q, k + 2],
                          coefficients[p, q, k + 3])  # fmt: skip
            even = wp.dot(row, wz)
            both = wx[a] * wy[b]
            result += wp.vec4(dx[a] * wy[b] * even, wx[a] * dy[b] * even, both * wp.dot(row, dz), both * even)
    scale = 0.5 * corner[3]
    return wp.vec4(scale * result[0], scale * result[1], scale * result[2], result[3])


@wp.func
def look(medium: Medium, at: wp.vec3):
    if medium.kind == FORMULA:
        return look_formula(medium.formula, at)
    if medium.kind == PLANE:
        return look_plane(medium.plane, medium.corner, at)
    return look_volume(medium.volume, medium.corner, at)


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
def outside(region: wp.array1d(dtype=float), ray: Ray):
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
    medium: Medium,
    starts: wp.array2d(dtype=float),
    region: wp.array1d(dtype=float),
    step: float,
    steps: int,
    scheme: int,
    every: int,
    ends: wp.array2d(dtype=float),
    path: wp.array3d(dtype=float),
    times: wp.array1d(dtype=float),
    index: int,
    n_row: int,
):
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
            wanted = way_of(ray, end, step) - rest
            total = way + wanted
            rest = (total - way) - wanted
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
    starts: wp.array2d(dtype=float),
    formula: wp.array1d(dtype=float),
    region: wp.array1d(dtype=float),
    step: float,
    steps: int,
    scheme: int,
    every: int,
    ends: wp.array2d(dtype=float),
    path: wp.array3d(dtype=float),
    times: wp.array1d(dtype=float),
    n_ray: int,
    n_row: int,
):
    medium = Medium()
    medium.kind = FORMULA
    medium.formula = formula
    run(medium, starts, region, step, steps, scheme, every, ends, path, times, wp.tid(), n_row)


@wp.kernel
def march_plane(
    starts: wp.array2d(dtype=float),
    coefficients: wp.array2d(dtype=float),
    corner: wp.array1d(dtype=float),
    region: wp.array1d(dtype=float),
    step: float,
    steps: int,
    scheme: int,
    every: int,
    ends: wp.array2d(dtype=float),
    path: wp.array3d(dtype=float),
    times: wp.array1d(dtype=float),
    n_ray: int,
    n_i: int,
    n_j: int,
    n_row: int,
):
    medium = Medium()
    medium.kind = PLANE
    medium.plane = coefficients
    medium.corner = wp.vec4(corner[0], corner[1], corner[2], corner[3])
    run(medium, starts, region, step, steps, scheme, every, ends, path, times, wp.tid(), n_row)


@wp.kernel
def march_volume(
    starts: wp.array2d(dtype=float),
    coefficients: wp.array3d(dtype=float),
    corner: wp.array1d(dtype=float),
    region: wp.array1d(dtype=float),
    step: float,
    steps: int,
    scheme: int,
    every: int,
    ends: wp.array2d(dtype=float),
    path: wp.array3d(dtype=float),
    times: wp.array1d(dtype=float),
    n_ray: int,
    n_i: int,
    n_j: int,
    n_k: int,
    n_row: int,
):
    medium = Medium()
    medium.kind = VOLUME
    medium.volume = coefficients
    medium.corner = wp.vec4(corner[0], corner[1], corner[2], corner[3])
    run(medium, starts, region, step, steps, scheme, every, ends, path, times, wp.tid(), n_row)

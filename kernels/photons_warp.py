"""Warp version of `photons`; a thread follows the photons of an item, one after the other."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False, "fast_math": False, "fuse_fp": False})


@wp.func
def philox(photon: wp.uint32, segment: int, seed: int) -> wp.vec4ui:
    a = photon
    b = wp.uint32(segment)
    c = wp.uint32(0)
    d = wp.uint32(0)
    k = wp.uint32(seed)
    m = wp.uint32(0)
    for _turn in range(7):
        one = wp.uint64(a) * wp.uint64(3528531795)
        two = wp.uint64(c) * wp.uint64(3449720151)
        a = wp.uint32(two >> wp.uint64(32)) ^ b ^ k
        b = wp.uint32(two)
        c = wp.uint32(one >> wp.uint64(32)) ^ d ^ m
        d = wp.uint32(one)
        k += wp.uint32(-1640531527)
        m += wp.uint32(-1150833019)
    return wp.vec4ui(a, b, c, d)


@wp.func
def unit(bits: wp.uint32) -> float:
    return (float(bits >> wp.uint32(9)) + 0.5) * 1.1920928955078125e-07


@wp.func
def free_path(value: float) -> float:
    share = float(value)
    power = float(0.0)
    while share < 0.70710677:
        share *= 2.0
        power += 1.0
    z = (share - 1.0) / (share + 1.0)
    s = z * z
    series = 1.0 + s * (0.33333334 + s * (0.2 + s * (0.14285715 + s * 0.11111111)))
    return power * 0.6931472 - 2.0 * z * series


@wp.func
def turn_of(x: float, y: float) -> float:
    wide = wp.abs(x)
    high = wp.abs(y)
    z = wp.min(wide, high) / wp.max(wp.max(wide, high), 1.0e-30)
    s = z * z
    angle = z * (
        0.15915132 + s * (-0.05293857 + s * (0.03080291 + s * (-0.01852985 + s * (0.00837909 + s * -0.00186516))))
    )
    angle = wp.where(high > wide, 0.25 - angle, angle)
    angle = wp.where(x < 0.0, 0.5 - angle, angle)
    return wp.where(y < 0.0, -angle, angle)


@wp.func
def scattered(u: wp.vec3, bits: wp.uint32, way: int, cosines: wp.array[float], ways: wp.array2d[float]) -> wp.vec3:
    place = unit(bits) * float(cosines.shape[0] - 1)
    low = int(place)
    cosine = cosines[low] + (place - float(low)) * (cosines[low + 1] - cosines[low])
    sine = wp.sqrt(wp.max(1.0 - cosine * cosine, 0.0))
    flat = wp.sqrt(u[0] * u[0] + u[1] * u[1])
    over = wp.max(flat, 1.0e-4)
    cx = wp.where(flat < 1.0e-4, 1.0, u[0] / over)
    cy = wp.where(flat < 1.0e-4, 0.0, u[1] / over)
    along = sine * ways[way, 0]
    across = sine * ways[way, 1]
    x = (along * (cx * u[2]) - across * cy) + u[0] * cosine
    y = (along * (cy * u[2]) + across * cx) + u[1] * cosine
    z = u[2] * cosine - along * flat
    length = wp.sqrt((x * x + y * y) + z * z)
    return wp.vec3(x / length, y / length, z / length)


@wp.func
def to_face(p: wp.vec3, u: wp.vec3, layer: int, faces: wp.array2d[float]) -> wp.vec2:
    """The path, and 1 for the inner face of the layer."""
    a = wp.max(u[0] * u[0] + u[1] * u[1], 1.0e-12)
    b = p[0] * u[0] + p[1] * u[1]
    square = p[0] * p[0] + p[1] * p[1]
    inner = faces[wp.max(layer - 1, 0), 0]
    outer = faces[layer, 0]
    inside = b * b - a * wp.max(square - inner * inner, 0.0)
    outside = b * b + a * wp.max(outer * outer - square, 0.0)
    if layer > 0 and b < 0.0 and inside > 0.0:
        return wp.vec2(wp.max((-b - wp.sqrt(inside)) / a, 0.0), 1.0)
    return wp.vec2(wp.max((wp.sqrt(outside) - b) / a, 0.0), 0.0)


@wp.func
def cross_face(
    p: wp.vec3, u: wp.vec3, bits: wp.uint32, inner: float, outer: float, inward: bool
) -> wp.vec4:  # fmt: skip
    """The direction behind a face of two indices, and 1 for a photon that passes it."""
    radius = wp.sqrt(p[0] * p[0] + p[1] * p[1])
    nx = p[0] / radius
    ny = p[1] / radius
    before = wp.where(inward, outer, inner)
    behind = wp.where(inward, inner, outer)
    normal = u[0] * nx + u[1] * ny
    cosine = wp.abs(normal)
    ratio = before / behind
    square = 1.0 - ratio * ratio * wp.max(1.0 - cosine * cosine, 0.0)
    after = wp.sqrt(wp.max(square, 0.0))
    s = (before * cosine - behind * after) / (before * cosine + behind * after)
    q = (before * after - behind * cosine) / (before * after + behind * cosine)
    if square > 0.0 and unit(bits) >= 0.5 * (s * s + q * q):
        bend = wp.where(inward, ratio * cosine - after, after - ratio * cosine)
        return wp.vec4(ratio * u[0] + bend * nx, ratio * u[1] + bend * ny, ratio * u[2], 1.0)
    bend = -2.0 * normal
    return wp.vec4(u[0] + bend * nx, u[1] + bend * ny, u[2], 0.0)


@wp.func
def add_path(
    rings: wp.array2d[int], lags: wp.array[int], per_ring: float, per_slice: float, tally: wp.array4d[wp.uint32],
    column: int, p: wp.vec3, u: wp.vec3, path: float, share: float, weight: float,
):  # fmt: skip
    for half in range(2):
        t = path * (share + 0.5 * float(half))
        x = p[0] + u[0] * t
        y = p[1] + u[1] * t
        z = p[2] + u[2] * t * per_slice
        ring = int(wp.sqrt(x * x + y * y) * per_ring)
        lag = wp.abs(int(wp.floor(wp.clamp(z, -1.0e6, 1.0e6) + 0.5)))
        if ring < rings.shape[0] and lag < lags.shape[0]:
            cells = rings[ring, 1]
            place = int(wp.floor(turn_of(x, y) * float(cells) + 0.5))
            place = rings[ring, 0] + wp.where(place < 0, place + cells, place) % cells
            value = wp.uint32(wp.min(weight * path * 524288.0, 4.0e9) + 0.5)
            if wp.atomic_add(tally, column, place, lags[lag], 0, value) + value < value:
                wp.atomic_add(tally, column, place, lags[lag], 1, wp.uint32(1))


@wp.kernel
def photons(
    rays: wp.array3d[float], faces: wp.array2d[float], rings: wp.array2d[int], lags: wp.array[int],
    cosines: wp.array[float], ways: wp.array2d[float], extinction: float, albedo: float, per_ring: float,
    per_slice: float, first: int, each: int, most: int, seed: int, absorbed: wp.array[wp.uint32],
    escaped: wp.array[wp.uint32], tally: wp.array4d[wp.uint32],
    n_column: int, n_ray: int, n_face: int, n_ring: int, n_lag: int, n_quantile: int, n_way: int, n_item: int,
    n_cell: int, n_bin: int,
) -> None:  # fmt: skip
    item = wp.tid()
    lost = int(0)
    left = int(0)
    for number in range(each):
        photon = first + item * each + number
        column = photon % n_column
        ray = photon // n_column % n_ray
        weight = rays[column, ray, 6]
        bits = philox(wp.uint32(photon), 0, seed)
        path = free_path(1.0 - unit(bits[0]) * rays[column, ray, 5]) / extinction
        u = wp.vec3(rays[column, ray, 2], rays[column, ray, 3], rays[column, ray, 4])
        p = wp.vec3(rays[column, ray, 0], rays[column, ray, 1], unit(bits[1]) - 0.5)
        p = wp.vec3(p[0] + u[0] * path, p[1] + u[1] * path, p[2] + u[2] * path * per_slice)
        u = scattered(u, bits[2], int(bits[3] >> wp.uint32(22)), cosines, ways)
        layer = wp.where(weight > 0.0, 0, n_face)
        segment = int(0)
        while segment < most and layer < n_face:
            segment += 1
            bits = philox(wp.uint32(photon), segment, seed)
            found = to_face(p, u, layer, faces)
            inward = found[1] > 0.0
            free = free_path(unit(bits[0])) / extinction
            collides = layer == 0 and free < found[0]
            path = wp.where(collides, free, found[0])
            if layer == 0:
                add_path(rings, lags, per_ring, per_slice, tally, column, p, u, path, unit(bits[1]) * 0.5, weight)
            p = wp.vec3(p[0] + u[0] * path, p[1] + u[1] * path, p[2] + u[2] * path * per_slice)
            if collides:
                if float(bits[3] & wp.uint32(4194303)) * 2.384185791015625e-07 < albedo:
                    u = scattered(u, bits[2], int(bits[3] >> wp.uint32(22)), cosines, ways)
                else:
                    lost += 1
                    segment = most
            else:
                at = wp.where(inward, layer - 1, layer)
                bent = cross_face(p, u, bits[2], faces[at, 1], faces[at, 2], inward)
                u = wp.vec3(bent[0], bent[1], bent[2])
                if bent[3] > 0.0:
                    layer += wp.where(inward, -1, 1)
        left += wp.where(layer == n_face, 1, 0)
    absorbed[item] = wp.uint32(lost)
    escaped[item] = wp.uint32(left)

"""Warp siblings of `trace`; a thread marches the rays of one pixel at one pose."""

from __future__ import annotations

import warp as wp

from vamgpu.kernels.wide_warp import Flat

wp.set_module_options({"enable_backward": False, "fast_math": False})

BENDS = wp.constant(1)
ABSORBS = wp.constant(2)
BLOCKS = wp.constant(4)
MARGIN = wp.constant(2)
EDGE = wp.constant(2.0)
SOLID = wp.constant(0.397)
ENDLESS = wp.constant(1.0e6)

Samples = wp.array4d(dtype=float)


@wp.struct
class Ray:
    position: wp.vec3
    heading: wp.vec3
    pull: wp.vec3  # half the gradient of the squared index there
    missing: wp.vec3  # what rounding took from the position: hundreds of steps would add it up
    light: float
    on: int
    middle: wp.vec3  # of its last step
    weight: float  # left there


@wp.func_native("""
    const char* at = (const char*)medium.data + (size_t)i * medium.strides[0] + (size_t)j * medium.strides[1] + k * 16;
#if defined(__CUDA_ARCH__)
    const float4 wide = *(const float4*)at;
    return wp::vec4(wide.x, wide.y, wide.z, wide.w);
#else
    return *(const wp::vec4*)at;
#endif
""")
def at_node(medium: Samples, i: int, j: int, k: int) -> wp.vec4:  # type: ignore[empty-body]
    ...


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
    """Adds to one lane; rays cross, so voxels have no owner."""
    ...


@wp.func
def look_up(medium: Samples, position: wp.vec3):
    """Gradient and extinction between the samples; the share of insert is the fifth."""
    n_p = medium.shape[0]
    n_q = medium.shape[1]
    n_s = medium.shape[2]
    x = wp.clamp(position[0] + EDGE, 0.0, float(n_p) - 1.0)
    y = wp.clamp(position[1] + EDGE, 0.0, float(n_q) - 1.0)
    z = wp.clamp(position[2] + EDGE, 0.0, float(n_s) - 1.0)
    i = wp.min(int(x), n_p - 2)
    j = wp.min(int(y), n_q - 2)
    k = wp.max(wp.min(int(z), n_s - 2), 0)
    a = x - float(i)
    b = y - float(j)
    c = z - float(k)
    layers = int(2)
    if n_s == 1:
        layers = 1
        c = 0.0
    g = wp.vec3(0.0, 0.0, 0.0)
    extinction = float(0.0)
    opacity = float(0.0)
    for di in range(2):
        for dj in range(2):
            for dk in range(layers):
                weight = wp.abs(1.0 - float(di) - a) * wp.abs(1.0 - float(dj) - b) * wp.abs(1.0 - float(dk) - c)
                node = at_node(medium, i + di, j + dj, k + dk)
                g += weight * wp.vec3(node[0], node[1], node[2])
                if node[3] < 0.0:
                    opacity += weight
                else:
                    extinction += weight * node[3]
    return g, extinction, opacity


@wp.func
def bend(medium: Samples, position: wp.vec3):
    g, extinction, opacity = look_up(medium, position)
    return g


@wp.func
def clip(origin: float, heading: float, high: float, span: wp.vec2):
    if wp.abs(heading) < 1.0e-9:
        if origin < -EDGE or origin > high:
            return wp.vec2(1.0e9, span[1])
        return span
    first = (-EDGE - origin) / heading
    second = (high - origin) / heading
    return wp.vec2(wp.max(span[0], wp.min(first, second)), wp.min(span[1], wp.max(first, second)))


@wp.func
def enter(
    medium: Samples, starts: wp.array2d(dtype=float), index: int, directions: wp.array2d(dtype=float), angle: int,
    top: float,
):  # fmt: skip
    """A start of the laboratory in the resin's coordinates, moved to the edge of the medium."""
    c = directions[angle, 0]
    s = directions[angle, 1]
    across = starts[index, 0]
    along = starts[index, 1]
    x = 0.5 * float(medium.shape[0] - 2 * MARGIN - 1) - across * s - along * c
    y = 0.5 * float(medium.shape[1] - 2 * MARGIN - 1) + across * c - along * s
    z = starts[index, 2]
    ray = Ray()
    ray.heading = wp.vec3(
        -starts[index, 3] * s - starts[index, 4] * c, starts[index, 3] * c - starts[index, 4] * s, starts[index, 5]
    )
    span = wp.vec2(0.0, 1.0e9)
    span = clip(x, ray.heading[0], float(medium.shape[0]) - EDGE - 1.0, span)
    span = clip(y, ray.heading[1], float(medium.shape[1]) - EDGE - 1.0, span)
    span = clip(z, ray.heading[2], top, span)
    ray.position = wp.vec3(x, y, z) + span[0] * ray.heading
    ray.pull = bend(medium, ray.position)
    ray.missing = wp.vec3(0.0, 0.0, 0.0)
    ray.light = starts[index, 6]
    ray.on = 0
    if span[0] < span[1] and ray.light > 0.0:
        ray.on = 1
    return ray


@wp.func
def advance(medium: Samples, ray: Ray, top: float, step: float, kind: int):
    here = ray.position
    heading = ray.heading
    way = step * heading
    turned = heading
    pull = ray.pull
    if (kind & BENDS) != 0:
        a = step * pull
        b = step * bend(medium, here + step * (0.5 * heading + 0.125 * a))
        pull = bend(medium, here + step * (heading + 0.5 * b))  # serves as the next step's first
        way = step * (heading + (a + 2.0 * b) / 6.0)
        turned = heading + (a + 4.0 * b + step * pull) / 6.0
    way -= ray.missing
    following = here + way
    length = 0.5 * step * wp.length(heading + turned)
    moved = Ray()
    moved.position = following
    moved.heading = turned
    moved.pull = pull
    moved.light = ray.light
    moved.missing = (following - here) - way
    moved.middle = here + 0.5 * way
    moved.weight = ray.light * length
    moved.on = 0
    if (
        following[0] >= -EDGE
        and following[1] >= -EDGE
        and following[2] >= -EDGE
        and following[0] <= float(medium.shape[0]) - EDGE - 1.0
        and following[1] <= float(medium.shape[1]) - EDGE - 1.0
        and following[2] <= top
    ):
        moved.on = 1
    if (kind & (ABSORBS | BLOCKS)) != 0:
        g, extinction, opacity = look_up(medium, moved.middle)
        if (kind & ABSORBS) != 0:
            depth = extinction * length
            # Warp has no expm1: the series where 1 - exp would cancel
            gone = 1.0 - wp.exp(-depth)
            if depth < 0.05:
                gone = depth * (1.0 - depth * (0.5 - depth * (1.0 / 6.0 - depth * (1.0 / 24.0 - depth / 120.0))))
            moved.weight = ray.light * gone
            moved.light = ray.light - moved.weight
        if (kind & BLOCKS) != 0 and opacity > SOLID:
            moved.weight = 0.0
            moved.on = 0
    return moved


@wp.func
def write_pair(
    entries: wp.array4d(dtype=float), angle: int, ray: int, count: int, x: int, y: int, n_x: int, n_y: int,
    weight: float,
):  # fmt: skip
    if weight <= 0.0 or x < 0 or y < 0 or x >= n_x or y >= n_y:
        return count
    if count < entries.shape[2]:
        entries[angle, ray, count, 0] = float(x * n_y + y)
        entries[angle, ray, count, 1] = weight
    return count + 1


@wp.kernel
def trace_entries(
    medium: Samples,
    starts: wp.array2d(dtype=float),
    directions: wp.array2d(dtype=float),
    step: float,
    most: int,
    kind: int,
    counts: wp.array2d(dtype=int),
    entries: wp.array4d(dtype=float),
    n_p: int,
    n_q: int,
    n_s: int,
    n_ray: int,
    n_angle: int,
    n_capacity: int,
):
    angle, index = wp.tid()
    n_x = n_p - 2 * MARGIN
    n_y = n_q - 2 * MARGIN
    ray = enter(medium, starts, index, directions, angle, ENDLESS)
    count = int(0)
    x = int(-9)
    y = int(-9)
    held = wp.vec4(0.0, 0.0, 0.0, 0.0)  # weights of cells (x, y), (x, y + 1), (x + 1, y), (x + 1, y + 1)
    taken = int(0)
    while taken < most and ray.on == 1:
        ray = advance(medium, ray, ENDLESS, step, kind)
        taken += 1
        i = int(wp.floor(ray.middle[0]))
        j = int(wp.floor(ray.middle[1]))
        if i != x or j != y:  # write what is left behind, keep what is still near
            kept = wp.vec4(0.0, 0.0, 0.0, 0.0)
            for corner in range(4):
                at_x = x + corner // 2
                at_y = y + corner % 2
                dx = at_x - i
                dy = at_y - j
                if dx >= 0 and dx <= 1 and dy >= 0 and dy <= 1:
                    kept[2 * dx + dy] = held[corner]
                else:
                    count = write_pair(entries, angle, index, count, at_x, at_y, n_x, n_y, held[corner])
            held = kept
            x = i
            y = j
        a = ray.middle[0] - float(i)
        b = ray.middle[1] - float(j)
        held += ray.weight * wp.vec4((1.0 - a) * (1.0 - b), (1.0 - a) * b, a * (1.0 - b), a * b)
    for corner in range(4):
        count = write_pair(entries, angle, index, count, x + corner // 2, y + corner % 2, n_x, n_y, held[corner])
    if ray.on == 1:
        count = -1
    counts[angle, index] = count


@wp.kernel
def survey_rays(
    medium: Samples,
    starts: wp.array2d(dtype=float),
    directions: wp.array2d(dtype=float),
    top: float,
    step: float,
    most: int,
    kind: int,
    steps: wp.array2d(dtype=int),
    n_p: int,
    n_q: int,
    n_s: int,
    n_ray: int,
    n_angle: int,
    n_pixel: int,
):
    angle, pixel = wp.tid()
    bundle = n_ray // n_pixel
    longest = int(0)
    for b in range(bundle):
        ray = enter(medium, starts, pixel * bundle + b, directions, angle, top)
        taken = int(0)
        while taken < most and ray.on == 1:
            ray = advance(medium, ray, top, step, kind)
            taken += 1
        longest = wp.where(ray.on == 1 or longest < 0, -1, wp.max(longest, taken))
    steps[angle, pixel] = longest


@wp.func
def share_of(medium: Samples, x: int, y: int, z: int, n_x: int, n_y: int, n_z: int, middle: wp.vec3, kind: int):
    """Weight of a voxel beside a point; none beyond the grid and in inserts."""
    if x < 0 or y < 0 or z < 0 or x >= n_x or y >= n_y or z >= n_z:
        return 0.0
    if (kind & BLOCKS) != 0:
        k = int(0)
        if medium.shape[2] > 1:
            k = z + MARGIN
        if at_node(medium, x + MARGIN, y + MARGIN, k)[3] < 0.0:
            return 0.0
    return (
        (1.0 - wp.abs(middle[0] - float(x)))
        * (1.0 - wp.abs(middle[1] - float(y)))
        * (1.0 - wp.abs(middle[2] - float(z)))
    )


@wp.kernel
def forward_traced(
    volume: Flat,
    medium: Samples,
    starts: wp.array2d(dtype=float),
    directions: wp.array2d(dtype=float),
    steps: wp.array2d(dtype=int),
    step: float,
    kind: int,
    lanes: int,
    sinogram: Flat,
    n_x: int,
    n_y: int,
    n_z: int,
    n_p: int,
    n_q: int,
    n_s: int,
    n_ray: int,
    n_angle: int,
    n_pixel: int,
    n_r: int,
    n_row: int,
):
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
            x0 = int(wp.floor(ray.middle[0]))
            y0 = int(wp.floor(ray.middle[1]))
            z0 = int(wp.floor(ray.middle[2]))
            met = float(0.0)
            for corner in range(8):
                x = x0 + corner // 4
                y = y0 + (corner // 2) % 2
                z = z0 + corner % 2
                share = share_of(medium, x, y, z, n_x, n_y, n_z, ray.middle, kind)
                if share > 0.0:
                    met += share * one(volume, z // wide, (x * n_y + y) * wide + z % wide)
            total += ray.weight * met
    r = pixel // n_row
    row = pixel % n_row
    put(sinogram, row // lanes, (angle * n_r + r) * lanes + row % lanes, total)


@wp.kernel
def back_traced(
    sinogram: Flat,
    medium: Samples,
    starts: wp.array2d(dtype=float),
    directions: wp.array2d(dtype=float),
    steps: wp.array2d(dtype=int),
    step: float,
    kind: int,
    lanes: int,
    volume: Flat,
    n_angle: int,
    n_r: int,
    n_row: int,
    n_p: int,
    n_q: int,
    n_s: int,
    n_ray: int,
    n_pixel: int,
    n_x: int,
    n_y: int,
    n_z: int,
):
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
            x0 = int(wp.floor(ray.middle[0]))
            y0 = int(wp.floor(ray.middle[1]))
            z0 = int(wp.floor(ray.middle[2]))
            for corner in range(8):
                x = x0 + corner // 4
                y = y0 + (corner // 2) % 2
                z = z0 + corner % 2
                share = share_of(medium, x, y, z, n_x, n_y, n_z, ray.middle, kind)
                if share * ray.weight > 0.0:
                    add(volume, z // wide, (x * n_y + y) * wide + z % wide, share * ray.weight * light)


@wp.kernel
def clear_volume(volume: wp.array4d(dtype=wp.vec4), n_x: int, n_y: int, n_z: int):
    slab, x, y, lane = wp.tid()
    volume[slab, x, y, lane] = wp.vec4(0.0, 0.0, 0.0, 0.0)

"""The co-rotating medium in Warp, and rays that march through it."""

from __future__ import annotations

import warp as wp

from vamgpu.kernels.wide_warp import READ_WIDE

wp.set_module_options({"enable_backward": False, "fast_math": False})

BENDS = 1
ABSORBS = 2
BLOCKS = 4
MARGIN = 2
EDGE = 2.0
SOLID = 0.397
WHOLE = 64.0
DARK = 28.0

Samples = wp.array4d[float]


@wp.struct
class Ray:
    position: wp.vec3
    heading: wp.vec3
    pull: wp.vec3  # half the gradient of the squared index there
    missing: wp.vec3  # rounding error of the position, which would add up over hundreds of steps
    light: float
    on: int
    middle: wp.vec3  # of its last step
    weight: float  # left there


@wp.func_native(
    """
    const char* at = (const char*)medium.data + (size_t)i * medium.strides[0] + (size_t)j * medium.strides[1] + k * 16;
"""
    + READ_WIDE
)
def at_node(medium: Samples, i: int, j: int, k: int) -> wp.vec4:  # type: ignore[empty-body]
    ...


@wp.func
def look_up(medium: Samples, position: wp.vec3):
    """Interpolated gradient and extinction; the share of insert is the fifth value."""
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
                    insert = wp.floor(-node[3])
                    rest = -node[3] - insert
                    opacity += weight * (insert / WHOLE)
                    extinction += weight * (rest / (1.0 - rest))
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
    medium: Samples, starts: wp.array2d[float], index: int, directions: wp.array2d[float], angle: int,
    top: float,
):  # fmt: skip
    """The ray of a start, rotated from fixed coordinates into the resin's and moved to the edge of the medium."""
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
        pull = bend(medium, here + step * (heading + 0.5 * b))  # serves as the next step's first value
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

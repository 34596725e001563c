"""Warp version of `trace`; a thread marches the rays of one pixel at one angle."""

from __future__ import annotations

import warp as wp

from vamgpu.kernels.medium_warp import MARGIN, Samples, advance, enter

wp.set_module_options({"enable_backward": False, "fast_math": False})

ENDLESS = 1.0e6


@wp.func
def write_pair(
    entries: wp.array4d[float], angle: int, ray: int, count: int, x: int, y: int, n_x: int, n_y: int,
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
    medium: Samples, starts: wp.array2d[float], directions: wp.array2d[float], step: float, most: int,
    kind: int, counts: wp.array2d[int], entries: wp.array4d[float],
    n_p: int, n_q: int, n_s: int, n_ray: int, n_angle: int, n_capacity: int,
) -> None:  # fmt: skip
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
        if i != x or j != y:  # write the cells left behind, keep those still near
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
    medium: Samples, starts: wp.array2d[float], directions: wp.array2d[float], top: float, step: float,
    most: int, kind: int, steps: wp.array2d[int],
    n_p: int, n_q: int, n_s: int, n_ray: int, n_angle: int, n_pixel: int,
) -> None:  # fmt: skip
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

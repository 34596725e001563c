"""Warp version of `attenuate`; a thread owns four lanes of z of one ray, or of one voxel."""

from __future__ import annotations

import warp as wp

from vamgpu.kernels.wide_warp import Flat, read, write

wp.set_module_options({"enable_backward": False, "fast_math": False})


@wp.kernel
def column_density(
    species: Flat, open: wp.array2d[wp.uint8], pose: wp.array[float], path: Flat,
    n_x: int, n_y: int, n_z: int, n_r: int, n_s: int,
) -> None:  # fmt: skip
    slab, ray, one, lane = wp.tid()
    lanes = species.shape[1] // (n_x * n_y)
    cosine = pose[0]
    sine = pose[1]
    radius = pose[6]
    r = (float(ray) - 0.5 * float(n_r - 1)) * pose[4]
    half = wp.sqrt(wp.max(0.0, radius * radius - r * r))
    total = wp.vec4(0.0, 0.0, 0.0, 0.0)
    at = ray * n_s * lanes + lane
    write(path, slab, at, total)
    begin = float(0.0) - half
    for k in range(1, n_s):
        end = wp.clamp(pose[5] * float(k) - radius, -half, half)
        if end > begin:
            s = 0.5 * (begin + end)
            i = (-r * sine - s * cosine) / pose[2] + 0.5 * float(n_x - 1)
            j = (r * cosine - s * sine) / pose[3] + 0.5 * float(n_y - 1)
            i0 = int(wp.floor(i))
            j0 = int(wp.floor(j))
            f = i - float(i0)
            g = j - float(j0)
            weights = float(0.0)
            part = wp.vec4(0.0, 0.0, 0.0, 0.0)
            for n in range(4):
                x = wp.clamp(i0 + n // 2, 0, n_x - 1)
                y = wp.clamp(j0 + n % 2, 0, n_y - 1)
                weight = wp.where(n // 2 == 1, f, 1.0 - f) * wp.where(n % 2 == 1, g, 1.0 - g) * float(open[x, y])
                weights += weight
                if weight > 0.0:
                    part += weight * read(species, slab, (x * n_y + y) * lanes + lane)
            total += ((end - begin) / wp.max(weights, 1.0e-6)) * part
            begin = end
        write(path, slab, at + k * lanes, total)


@wp.func
def faded(light: wp.vec4, mu: float, epsilon: float, length: float, dense: wp.vec4):
    result = light
    for k in range(4):
        result[k] = light[k] * wp.exp(-mu * length - epsilon * dense[k])
    return result


@wp.kernel
def expose(
    path: Flat, visible_light: Flat, ultraviolet_light: Flat, angle: int, pose: wp.array[float],
    extinction: wp.array2d[float], visible: Flat, ultraviolet: Flat,
    n_r: int, n_s: int, n_z: int, n_angle: int, n_x: int, n_y: int,
) -> None:  # fmt: skip
    slab, row, column, lane = wp.tid()
    lanes = visible.shape[1] // (n_x * n_y)
    x = (float(row) - 0.5 * float(n_x - 1)) * pose[2]
    y = (float(column) - 0.5 * float(n_y - 1)) * pose[3]
    radius = pose[6]
    r = y * pose[0] - x * pose[1]
    s = -(x * pose[0] + y * pose[1])
    u = r / pose[4] + 0.5 * float(n_r - 1)
    at = (row * n_y + column) * lanes + lane
    if x * x + y * y > radius * radius or u < 0.0 or u > float(n_r - 1):
        write(visible, slab, at, wp.vec4(0.0, 0.0, 0.0, 0.0))
        write(ultraviolet, slab, at, wp.vec4(0.0, 0.0, 0.0, 0.0))
        return
    length = wp.max(0.0, s + wp.sqrt(wp.max(0.0, radius * radius - r * r)))
    w = wp.clamp((s + radius) / pose[5], 0.0, float(n_s - 1))
    i = wp.clamp(int(u), 0, wp.max(n_r - 2, 0))
    k = wp.clamp(int(w), 0, wp.max(n_s - 2, 0))
    i1 = wp.min(i + 1, n_r - 1)
    k1 = wp.min(k + 1, n_s - 1)
    f = u - float(i)
    g = w - float(k)
    near = i * n_s * lanes + lane
    far = i1 * n_s * lanes + lane
    dense = (1.0 - f) * ((1.0 - g) * read(path, slab, near + k * lanes) + g * read(path, slab, near + k1 * lanes))
    dense += f * ((1.0 - g) * read(path, slab, far + k * lanes) + g * read(path, slab, far + k1 * lanes))
    left = (angle * n_r + i) * lanes + lane
    right = (angle * n_r + i1) * lanes + lane
    seen = (1.0 - f) * read(visible_light, slab, left) + f * read(visible_light, slab, right)
    hidden = (1.0 - f) * read(ultraviolet_light, slab, left) + f * read(ultraviolet_light, slab, right)
    write(visible, slab, at, faded(seen, extinction[0, 0], extinction[0, 1], length, dense))
    write(ultraviolet, slab, at, faded(hidden, extinction[1, 0], extinction[1, 1], length, dense))

"""Warp version of `flip`; a thread owns four lanes of z."""

from __future__ import annotations

import warp as wp

from vamgpu.kernels.wide_warp import Vectors

wp.set_module_options({"enable_backward": False, "fast_math": False})


@wp.func
def off(dose: float, side: float, least: float, most: float, leak: float):
    beyond = float(0.0)
    if side > 0.0:
        beyond = wp.max(wp.max(least - dose, dose - most), 0.0)
    if side < 0.0:
        beyond = wp.max(dose - leak, 0.0)
    return beyond * beyond


@wp.kernel
def price_flips(
    dose: Vectors, side: Vectors, least: float, most: float, leak: float, step: float,
    brighter: Vectors, darker: Vectors, n_i: int, n_j: int, n_z: int,
) -> None:  # fmt: skip
    slab, i, j, lane = wp.tid()
    given = dose[slab, i, j, lane]
    where = side[slab, i, j, lane]
    more = wp.vec4(0.0, 0.0, 0.0, 0.0)
    less = wp.vec4(0.0, 0.0, 0.0, 0.0)
    for k in range(4):
        now = off(given[k], where[k], least, most, leak)
        more[k] = (off(given[k] + step, where[k], least, most, leak) - now) / step
        less[k] = (off(given[k] - step, where[k], least, most, leak) - now) / step
    brighter[slab, i, j, lane] = more
    darker[slab, i, j, lane] = less


@wp.kernel
def flip_pixels(
    brighter: Vectors, darker: Vectors, step: Vectors, light: Vectors, change: Vectors, n_i: int, n_j: int, n_z: int,
) -> None:  # fmt: skip
    slab, i, j, lane = wp.tid()
    shown = light[slab, i, j, lane]
    by = step[slab, i, j, lane]
    on = brighter[slab, i, j, lane]
    dark = darker[slab, i, j, lane]
    added = wp.vec4(0.0, 0.0, 0.0, 0.0)
    for k in range(4):
        if shown[k] > 0.0:
            if dark[k] < 0.0:
                added[k] = -by[k]
        elif on[k] < 0.0:
            added[k] = by[k]
    change[slab, i, j, lane] = added
    light[slab, i, j, lane] = shown + added


@wp.kernel
def step_pixels(
    brighter: Vectors, darker: Vectors, worth: float, seed: int, first: int, step: float, most: float,
    light: Vectors, n_i: int, n_j: int, n_z: int,
) -> None:  # fmt: skip
    slab, i, j, lane = wp.tid()
    up = brighter[slab, i, j, lane]
    down = darker[slab, i, j, lane]
    shown = light[slab, i, j, lane]
    column = wp.uint32(i) * wp.uint32(3518319155) + wp.uint32(j) * wp.uint32(2882110345)
    column = column + wp.uint32(seed) * wp.uint32(2654435769)
    for k in range(4):
        z = first + 4 * (slab * light.shape[3] + lane) + k
        place = column + wp.uint32(z) * wp.uint32(2360945575)
        if float(place >> wp.uint32(8)) / 16777216.0 * worth < -wp.min(up[k], down[k]):
            by = step
            if up[k] > down[k]:
                by = -step
            shown[k] = wp.clamp(shown[k] + by, 0.0, most)
    light[slab, i, j, lane] = shown

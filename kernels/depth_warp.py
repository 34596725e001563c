"""Warp version of `depth`; a thread owns four lanes of z of a voxel, or of `ROWS` rows."""

from __future__ import annotations

from typing import Any

import warp as wp

from vamgpu.kernels import depth as definition
from vamgpu.kernels.wide_warp import Vectors, real_lanes, slice_of

wp.set_module_options({"enable_backward": False, "fast_math": False})

ROWS = definition.ROWS
FARTHEST, SIDE, STEPS = definition.FARTHEST, definition.SIDE, definition.STEPS
NO_CUT: Any = wp.constant(definition.NO_CUT)
NO_DEPTH: Any = wp.constant(definition.NO_DEPTH)
FULL: Any = wp.constant(definition.FULL)
THIN: Any = wp.constant(definition.THIN)
PATCH: Any = wp.constant(definition.PATCH)
HALF: Any = wp.constant(definition.HALF)


@wp.func
def value_at(field: Vectors, x: int, y: int, z: int, n_z: int):
    i = wp.clamp(x, 0, field.shape[1] - 1)
    j = wp.clamp(y, 0, field.shape[2] - 1)
    return slice_of(field, i, j, wp.clamp(z, 0, n_z - 1))


@wp.func
def normal_at(fraction: Vectors, x: int, y: int, z: int, n_z: int):
    """Inward normal of the surface in a voxel."""
    gradient = wp.vec3(0.0, 0.0, 0.0)
    for i in range(-1, 2):
        for j in range(-1, 2):
            for k in range(-1, 2):
                weight = 4.0 / float(1 << (i * i + j * j + k * k))
                value = weight * value_at(fraction, x + i, y + j, z + k, n_z)
                gradient += value * wp.vec3(float(i), float(j), float(k))
    length = wp.length(gradient)
    if length < 1e-6:
        return wp.vec3(0.0, 0.0, 1.0)
    return gradient / length


@wp.func
def corner(cut: wp.float64, at: wp.float64, sign: wp.float64):
    """Contribution of a corner of the cube to slope and share."""
    beyond = wp.max(cut - at, wp.float64(0.0))
    return wp.vec2d(sign * beyond * beyond, sign * beyond * beyond * beyond)


@wp.func
def place_of(normal: wp.vec3, fraction: float):
    """Depth of the center of a unit cube behind the plane that leaves a fraction of it, by Newton's method."""
    a = wp.float64(wp.max(wp.abs(normal[0]), THIN))
    b = wp.float64(wp.max(wp.abs(normal[1]), THIN))
    c = wp.float64(wp.max(wp.abs(normal[2]), THIN))
    zero, one, three = wp.float64(0.0), wp.float64(1.0), wp.float64(3.0)
    volume, half = wp.float64(6.0) * a * b * c, wp.float64(0.5) * (a + b + c)
    filled = wp.float64(fraction)
    less, cut = wp.min(filled, one - filled), half + zero
    for _ in range(STEPS):
        found = corner(cut, zero, one) - corner(cut, a, one) - corner(cut, b, one) - corner(cut, c, one)
        found += corner(cut, a + b, one) + corner(cut, a + c, one) + corner(cut, b + c, one)
        found -= corner(cut, a + b + c, one)
        slope = wp.max(three * found[0] / volume, wp.float64(1e-9))
        cut = wp.max(cut - (found[1] / volume - less) / slope, zero)
    return float(wp.where(filled < wp.float64(0.5), cut - half, half - cut))


@wp.kernel
def cut_voxels(fraction: Vectors, place: Vectors, steps: Vectors, n_x: int, n_y: int, n_z: int) -> None:
    slab, x, y, lane = wp.tid()
    places = wp.vec4(NO_CUT, NO_CUT, NO_CUT, NO_CUT)
    packed = wp.vec4(NO_CUT, NO_CUT, NO_CUT, NO_CUT)
    for k in range(real_lanes(slab, lane, place.shape[3], n_z)):
        z = 4 * (slab * place.shape[3] + lane) + k
        own = value_at(fraction, x, y, z, n_z)
        most = float(0.0)
        for side in range(-1, 2):
            most = wp.max(most, wp.abs(value_at(fraction, x + side, y, z, n_z) - own))
            most = wp.max(most, wp.abs(value_at(fraction, x, y + side, z, n_z) - own))
            most = wp.max(most, wp.abs(value_at(fraction, x, y, z + side, n_z) - own))
        if (own > FULL and own < 1.0 - FULL) or most > 1.0 - 2.0 * FULL:
            packed[k] = float(FARTHEST * (1 + SIDE + SIDE * SIDE))
            places[k] = place_of(normal_at(fraction, x, y, z, n_z), own)
    place[slab, x, y, lane] = places
    steps[slab, x, y, lane] = packed


@wp.kernel
def nearest_cut(steps: Vectors, axis: int, span: int, nearest: Vectors, n_x: int, n_y: int, n_z: int) -> None:
    slab, x, y, lane = wp.tid()
    best = wp.vec4(NO_CUT, NO_CUT, NO_CUT, NO_CUT)
    unit = wp.where(axis == 0, 1, wp.where(axis == 1, SIDE, SIDE * SIDE))
    for step in range(-span, span + 1):
        more = float(step * step * SIDE * SIDE * SIDE + step * unit)
        if axis < 2:
            i = x - wp.where(axis == 0, step, 0)
            j = y - wp.where(axis == 1, step, 0)
            if i >= 0 and i < n_x and j >= 0 and j < n_y:
                best = wp.min(best, steps[slab, i, j, lane] + wp.vec4(more, more, more, more))
        else:
            for k in range(4):
                z = 4 * (slab * nearest.shape[3] + lane) + k - step
                if z >= 0 and z < n_z:
                    best[k] = wp.min(best[k], slice_of(steps, x, y, z) + more)
    nearest[slab, x, y, lane] = best


@wp.kernel
def signed_depths(
    fraction: Vectors, place: Vectors, steps: Vectors, first: int, lanes: int, reach: float, pitch: float,
    depth: Vectors, n_x: int, n_y: int, n_source: int, n_z: int,
) -> None:  # fmt: skip
    slab, x, y, lane = wp.tid()
    result = wp.vec4(0.0, 0.0, 0.0, 0.0)
    limit = float(SIDE * SIDE * SIDE) * wp.floor((reach + 1.0) * (reach + 1.0) + 1.0)  # no nearer surface lies beyond
    for n in range(real_lanes(slab, lane, depth.shape[3], n_z)):
        z = first + 4 * (slab * depth.shape[3] + lane) + n
        found = reach
        if slice_of(steps, x, y, z) < limit:
            packed = int(slice_of(steps, x, y, z))
            i = packed % SIDE - FARTHEST
            j = packed // SIDE % SIDE - FARTHEST
            k = packed // (SIDE * SIDE) % SIDE - FARTHEST
            step = wp.vec3(float(i), float(j), float(k))
            across = wp.dot(step, normal_at(fraction, x - i, y - j, z - k, n_source))
            beside = wp.sqrt(wp.max(wp.dot(step, step) - across * across, 0.0))
            behind = across + slice_of(place, x - i, y - j, z - k)
            found = wp.min(wp.length(wp.vec2(behind, wp.max(beside - PATCH, 0.0))), reach)
        result[n] = pitch * wp.where(slice_of(fraction, x, y, z) >= HALF, found, -found)
    depth[slab, x, y, lane] = result


@wp.kernel
def tally_depths(
    dose: Vectors, depth: Vectors, ends: wp.array2d[int], width: float, rounding: float, least: wp.array2d[float],
    greatest: wp.array2d[float], counts: wp.array2d[wp.uint32],
    n_i: int, n_j: int, n_z: int, n_part: int, n_bin: int,
) -> None:  # fmt: skip
    slab, strip, column, lane = wp.tid()
    if strip * ROWS >= n_i:
        return
    part = (slab * ((n_i + ROWS - 1) // ROWS) + strip) * dose.shape[3] + lane
    last = n_bin - 2
    for b in range(n_bin):
        least[part, b] = float(wp.inf)
        greatest[part, b] = -float(wp.inf)
        counts[part, b] = wp.uint32(0)
    most = -float(wp.inf)
    for i in range(strip * ROWS, wp.min(strip * ROWS + ROWS, n_i)):
        for j in range(wp.max(ends[i, 0], 0), wp.min(ends[i, 1], n_j)):
            values = dose[slab, i, j, lane]
            depths = depth[slab, i, j, lane]
            for k in range(real_lanes(slab, lane, dose.shape[3], n_z)):
                value = values[k]
                if depths[k] > NO_DEPTH:
                    if value > most or not wp.isfinite(value):
                        most = value
                    b = int(wp.min(wp.abs(depths[k]) / width + rounding, float(last)))
                    if depths[k] >= 0.0:
                        least[part, b] = wp.min(least[part, b], value)
                        counts[part, b] = counts[part, b] + wp.uint32(1)
                    else:
                        greatest[part, b] = wp.max(greatest[part, b], value)
    greatest[part, last + 1] = wp.where(most == wp.inf, wp.nan, most)

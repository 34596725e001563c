"""Warp version of `proof`; a thread owns four lanes, in each of four slabs if one look-up serves all of them."""

from __future__ import annotations

import warp as wp

from vamgpu.kernels.light_warp import sampled
from vamgpu.kernels.wide_warp import Flat, four_slabs, read, read_one, write_four

wp.set_module_options({"enable_backward": False, "fast_math": False})


@wp.kernel
def spread_rows(
    light: Flat, shares: wp.array2d[float], span: wp.array2d[int], lanes: int, spread: Flat,
    n_angle: int, n_r: int, n_row: int, n_slice: int, n_z: int,
) -> None:  # fmt: skip
    slab, angle, r, lane = wp.tid()
    own = spread.shape[1] // (n_angle * n_r)
    z = 4 * (slab * own + lane)
    result = wp.vec4(0.0, 0.0, 0.0, 0.0)
    for row in range(span[z, 0], span[z + 3, 1]):
        at = row % lanes
        value = read_one(light, row // lanes, (angle * n_r + r) * (lanes // 4) + at // 4, at % 4)
        result += value * wp.vec4(shares[row, z], shares[row, z + 1], shares[row, z + 2], shares[row, z + 3])
    spread[slab, (angle * n_r + r) * own + lane] = result


@wp.kernel
def spread_columns(
    spread: Flat, first: wp.array[int], shares: wp.array2d[float], profile: Flat,
    n_angle: int, n_r: int, n_z: int, n_bin: int, n_tap: int,
) -> None:  # fmt: skip
    slab, angle, bin, lane = wp.tid()
    lanes = profile.shape[1] // (n_angle * n_bin)
    result = wp.vec4(0.0, 0.0, 0.0, 0.0)
    for tap in range(n_tap):
        result += shares[bin, tap] * read(spread, slab, (angle * n_r + first[bin] + tap) * lanes + lane)
    profile[slab, (angle * n_bin + bin) * lanes + lane] = result


@wp.func
def place_beyond(first: float, second: float, edge: float) -> float:
    """Mean of t²/2 while a position moves uniformly from first to second; t: distance beyond an edge, or 0."""
    low = wp.min(first, second) - edge
    high = wp.max(first, second) - edge
    if low >= 0.0:
        return (low * low + low * high + high * high) / 6.0
    if high <= 0.0:
        return 0.0
    return high * high * high / (6.0 * (high - low))


@wp.func
def beyond(first: wp.vec4, second: wp.vec4, bin: int) -> float:
    """The same for the light between both ends, about the middle of a bin."""
    edge = float(bin) + 0.5
    return place_beyond(first[1], second[1], edge) - place_beyond(first[0], second[0], edge)


@wp.kernel(launch_bounds=(256, 3))  # fewer registers allow more threads, which hide the loads
def expose_voxels(
    profile: Flat, poses: wp.array2d[float], pose: wp.array4d[float], scale: float, single: float,
    radius: float, dose: Flat,
    n_angle: int, n_bin: int, n_z: int, n_arc: int, n_branch: int, n_across: int, n_along: int, n_x: int, n_y: int,
) -> None:  # fmt: skip
    block, i, j, lane = wp.tid()
    slabs = four_slabs(4 * block, dose.shape[0])
    lanes = dose.shape[1] // (n_x * n_y)
    x = float(i) - 0.5 * float(n_x - 1)
    y = float(j) - 0.5 * float(n_y - 1)
    t0 = wp.vec4(0.0, 0.0, 0.0, 0.0)
    t1 = wp.vec4(0.0, 0.0, 0.0, 0.0)
    t2 = wp.vec4(0.0, 0.0, 0.0, 0.0)
    t3 = wp.vec4(0.0, 0.0, 0.0, 0.0)
    far = x * x + y * y
    if far <= radius * radius:
        branches = n_branch
        if far <= single * single:
            branches = 1
        for arc in range(n_arc):
            half = poses[arc, 3]
            across = (y * poses[arc, 0] - x * poses[arc, 1]) * scale
            along = (-x * poses[arc, 0] - y * poses[arc, 1]) * scale
            profile_of = arc / (n_arc / n_angle) * n_bin
            for branch in range(branches):
                before = sampled(pose[branch], across - half * along, along + half * across)
                after = before
                if half > 0.0:
                    after = sampled(pose[branch], across + half * along, along - half * across)
                low = wp.min(before[0], after[0])
                high = wp.max(before[1], after[1])
                share = 0.5 * poses[arc, 2] * (before[2] + after[2])
                if high > low:
                    first = wp.max(int(wp.floor(low - 0.5)), 0)
                    last = beyond(before, after, first - 1)
                    here = beyond(before, after, first)
                    for bin in range(first, wp.min(int(wp.ceil(high + 0.5)), n_bin)):
                        ahead = beyond(before, after, bin + 1)
                        weight = share * (last - 2.0 * here + ahead)
                        last = here
                        here = ahead
                        index = (profile_of + bin) * lanes + lane
                        t0 += weight * read(profile, slabs[0], index)
                        t1 += weight * read(profile, slabs[1], index)
                        t2 += weight * read(profile, slabs[2], index)
                        t3 += weight * read(profile, slabs[3], index)
    write_four(dose, slabs, (i * n_y + j) * lanes + lane, t0, t1, t2, t3)


@wp.kernel
def average_voxels(
    fine: Flat, taps: wp.array2d[float], finer: int, corner_x: int, corner_y: int, first: int, volume: Flat,
    n_u: int, n_v: int, n_level: int, n_tap: int, n_x: int, n_y: int, n_z: int,
) -> None:  # fmt: skip
    slab, x, y, lane = wp.tid()
    lanes = volume.shape[1] // (n_x * n_y)
    source = slab - first // (4 * lanes)
    if source >= 0 and source < fine.shape[0]:
        total = wp.vec4(0.0, 0.0, 0.0, 0.0)
        for a in range(n_tap):
            i = corner_x + finer * x + a
            if i >= 0 and i < n_u:
                for b in range(n_tap):
                    j = corner_y + finer * y + b
                    if j >= 0 and j < n_v:
                        total += taps[0, a] * taps[1, b] * read(fine, source, (i * n_v + j) * lanes + lane)
        volume[slab, (x * n_y + y) * lanes + lane] = total

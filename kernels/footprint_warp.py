"""Warp version of `footprint`: tiles of 2 × 2 voxels, or of four columns of an angle (see `tile_warp`).

Footprints take longer than the lanes that use them: the members of a tile compute those of the next angles, or planes,
together.
"""

from __future__ import annotations

import warp as wp

from vamgpu.kernels.light_warp import Span, cells_of, sampled, span_of
from vamgpu.kernels.tile_warp import TURNS, Tile, gathered, meet, no_sums, number, samples_before, share, tile_of
from vamgpu.kernels.wide_warp import Flat, write_four

wp.set_module_options({"enable_backward": False, "fast_math": True})

TAIL = 2.75
FAR = 4.0
FADE = 0.25
SHARP = 1.0e-3
THINNEST = 0.05
BLURRED = 0.2
BEYOND = 1.0e6  # columns; more than any pattern has

Ray: type = wp.types.vector(length=5, dtype=float)
"""Column; half sum and half difference of the boxes; gain; reach."""


@wp.func
def third_integral(x: float, sigma: float, inverse_sigma: float):
    t = wp.abs(x) * inverse_sigma
    series = t * 7.122526186e-05 + 2.423642034e-04
    series = t * series + 3.491863407e-03
    series = t * series + 2.202380776e-02
    series = t * series + 9.973836443e-02
    series = t * series + 1.0
    series = series * series
    series = series * series
    series = series * series
    series = series * series
    square = sigma * sigma
    tail = 0.25 * square / series
    return wp.where(x > 0.0, 0.5 * (x * x + square) - tail, tail)


@wp.func
def edge(x: float, outer: float, inner: float, sigma: float, inverse_sigma: float):
    """Integral of the voxel's blurred trapezoid from −∞ to x, times the areas of its boxes."""
    if sigma == 0.0:
        a = wp.max(x + outer, 0.0)
        b = wp.max(x - outer, 0.0)
        c = wp.max(x + inner, 0.0)
        d = wp.max(x - inner, 0.0)
        return 0.5 * ((a * a + b * b) - (c * c + d * d))
    return (third_integral(x + outer, sigma, inverse_sigma) + third_integral(x - outer, sigma, inverse_sigma)) - (
        third_integral(x + inner, sigma, inverse_sigma) + third_integral(x - inner, sigma, inverse_sigma)
    )


@wp.func
def footprint(
    light: wp.array3d[float], n_r: int, directions: wp.array2d[float], pose: int, x: float, y: float, bent: int,
    ratio: float, strength: float, fill: float, sigma: float, radius: float,
):  # fmt: skip
    """Column and footprint of one voxel at one pose; voxels outside the radius reach nothing."""
    if x * x + y * y > radius * radius:
        return Ray(0.0, 1.0, 0.0, 0.0, -BEYOND)
    c, s, arc = directions[pose, 0], directions[pose, 1], directions[pose, 2]
    across = y * c - x * s
    along = -x * c - y * s
    u = across * ratio + 0.5 * float(n_r - 1)
    gain = strength
    by_across = ratio
    by_along = float(0.0)
    if bent != 0:
        ray = sampled(light, across, along)
        u = ray[0]
        gain = ray[1]
        by_across = ray[2]
        by_along = ray[3]
    a = wp.abs(by_across * s + by_along * c)
    b = wp.abs(by_across * c - by_along * s)
    moved = wp.abs(by_across * along - by_along * across) * arc
    thin = wp.min(a, b)
    if moved > 0.0:  # the widest of three boxes is kept, the other two are merged
        side = wp.max(a, b)
        other = wp.min(side, moved)
        thin = wp.min(wp.max(side, moved), wp.sqrt(thin * thin + other * other))
    least = THINNEST + BLURRED * sigma
    thin = wp.max(thin, least)
    wide = wp.sqrt(wp.max(moved * moved + (a * a + b * b) - thin * thin, least * least))
    outer = 0.5 * (wide + thin)
    reach = wp.max(outer + 0.5 * fill + TAIL * sigma, FAR * sigma)
    return Ray(u, outer, 0.5 * (wide - thin), gain / (wide * thin * fill), reach)


@wp.func
def faded(distance: float, reach: float, sigma: float):
    """The part of a share that counts: all but near the end of its reach."""
    return wp.clamp((reach - wp.abs(distance)) * (1.0 / (FADE * sigma + SHARP)), 0.0, 1.0)


@wp.func
def voxel(x: int, n: int):
    return float(x) - 0.5 * float(n - 1)


@wp.func
def inverse_of(sigma: float):
    """1/σ, or 0 without blur."""
    return wp.where(sigma > 0.0, 1.0 / wp.max(sigma, 1.0e-9), 0.0)


@wp.func
def share_columns(
    slot: int, i: int, sample: int, lanes: int, count: int, ray: Ray, first: int, fill: float, sigma: float
):  # fmt: skip
    """Store the shares of a tile's voxel i in its columns; the first is a sample of the sinogram."""
    inverse_sigma = inverse_of(sigma)
    distance = ray[0] - float(first)
    above = edge(distance + 0.5 * fill, ray[1], ray[2], sigma, inverse_sigma)
    for k in range(count):
        below = edge(distance - 0.5 * fill, ray[1], ray[2], sigma, inverse_sigma)
        weight = faded(distance, ray[4], sigma) * ray[3] * wp.max(above - below, 0.0)
        share(slot + k, i, wp.vec4(weight, 0.0, 0.0, 0.0))
        if i == 0:
            number(slot + k, True, (sample + k) * lanes)
        distance -= 1.0
        above = below
        if fill != 1.0:
            above = edge(distance + 0.5 * fill, ray[1], ray[2], sigma, inverse_sigma)


@wp.func
def four_shares(ray: Ray, first: int, fill: float, sigma: float):
    """A voxel's shares of four columns."""
    inverse_sigma = inverse_of(sigma)
    above = edge(ray[0] - float(first) + 0.5 * fill, ray[1], ray[2], sigma, inverse_sigma)
    shares = wp.vec4(0.0)
    for column in range(4):
        distance = ray[0] - float(first + column)
        below = edge(distance - 0.5 * fill, ray[1], ray[2], sigma, inverse_sigma)
        shares[column] = faded(distance, ray[4], sigma) * ray[3] * wp.max(above - below, 0.0)
        above = below
        if fill != 1.0:
            above = edge(distance - 1.0 + 0.5 * fill, ray[1], ray[2], sigma, inverse_sigma)
    return shares


@wp.func
def most_cells(span: Span):
    """Cells of a plane, at most."""
    gap = span.high[0] - span.low[0]
    change = (span.high[1] - span.low[1]) * float(span.planes - 1)
    return wp.max(wp.abs(gap), wp.abs(gap + change)) + 2.0 * span.slack


@wp.func
def find_window(at: Tile, turn: int, skip: int, widest: int, n_r: int):
    """The columns of an angle that light the four voxels of a tile, after ``skip`` of them."""
    first = int(1000000)
    final = int(-1)
    for i in range(4):
        first = wp.min(first, number(at.slots + 8 * turn + 2 * i, False, 0))
        final = wp.max(final, number(at.slots + 8 * turn + 2 * i + 1, False, 0))
    first = wp.max(first, 0) + skip
    number(at.windows + 2 * turn, True, first)
    width = wp.clamp(wp.min(final, n_r - 1) - first + 1, 0, wp.min(widest, at.samples))
    number(at.windows + 2 * turn + 1, True, width)


@wp.kernel(launch_bounds=(256, 2))
def back_footprint(
    sinogram: Flat, directions: wp.array2d[float], light: wp.array3d[float], bent: int, ratio: float,
    strength: float, fill: float, sigma: float, radius: float, taps: int, volume: Flat,
    n_angle: int, n_r: int, n_z: int, n_across: int, n_along: int, n_x: int, n_y: int,
) -> None:  # fmt: skip
    i0, i1, i2, i3 = wp.tid()
    lanes = volume.shape[1] // (n_x * n_y)
    at = tile_of(volume.shape[0], lanes, 4, 16, (n_x + 1) // 2, (n_y + 1) // 2, wp.vec4i(i0, i1, i2, i3))
    row = 2 * at.major
    column = 2 * at.minor
    t0, t1, t2, t3 = no_sums()
    widest = taps + int(1.4143 * ratio) + 1  # columns of a tile, at most
    at_once = wp.clamp(at.samples // wp.max(widest, 8), 1, TURNS)
    for first_pose in range(0, n_angle, at_once):
        turns = wp.min(at_once, n_angle - first_pose)
        for skip in range(0, widest, at.samples):
            meet(at.members)
            for work in range(at.member, 4 * turns, at.members):  # columns of each voxel, among the following samples
                pose = first_pose + work // 4
                x = voxel(row + work % 4 // 2, n_x)
                y = voxel(column + work % 2, n_y)
                ray = footprint(light, n_r, directions, pose, x, y, bent, ratio, strength, fill, sigma, radius)
                number(at.slots + 2 * work, True, int(wp.ceil(ray[0] - ray[4])))
                number(at.slots + 2 * work + 1, True, int(wp.floor(ray[0] + ray[4])))
            meet(at.members)
            for turn in range(at.member, turns, at.members):
                find_window(at, turn, skip, widest, n_r)
            meet(at.members)
            for work in range(at.member, 4 * turns, at.members):
                i = work % 4
                turn = work // 4
                first = number(at.windows + 2 * turn, False, 0)
                count = number(at.windows + 2 * turn + 1, False, 0)
                slot = at.slots + samples_before(at.windows, turn)
                pose = first_pose + turn
                x = voxel(row + i // 2, n_x)
                y = voxel(column + i % 2, n_y)
                ray = footprint(light, n_r, directions, pose, x, y, bent, ratio, strength, fill, sigma, radius)
                share_columns(slot, i, pose * n_r + first, lanes, count, ray, first, fill, sigma)
            meet(at.members)
            count = samples_before(at.windows, turns)
            t0, t1, t2, t3 = gathered(t0, t1, t2, t3, sinogram, at, count)
    for i in range(4):
        if row + i // 2 < n_x and column + i % 2 < n_y:
            at_voxel = ((row + i // 2) * n_y + column + i % 2) * lanes + at.lane
            write_four(volume, at.slabs, at_voxel, t0[i], t1[i], t2[i], t3[i])


@wp.kernel(launch_bounds=(256, 2))
def forward_footprint(
    volume: Flat, directions: wp.array2d[float], light: wp.array3d[float], edges: wp.array2d[float],
    bent: int, ratio: float, strength: float, fill: float, sigma: float, radius: float, taps: int, cells: int,
    sinogram: Flat,
    n_x: int, n_y: int, n_z: int, n_angle: int, n_across: int, n_along: int, n_r: int,
) -> None:  # fmt: skip
    i0, i1, i2, i3 = wp.tid()
    lanes = volume.shape[1] // (n_x * n_y)
    at = tile_of(volume.shape[0], lanes, 8, 8, n_angle, (n_r + 3) // 4, wp.vec4i(i0, i1, i2, i3))
    angle = wp.min(at.major, n_angle - 1)
    r = 4 * at.minor
    t0, t1, t2, t3 = no_sums()
    pose = wp.vec4(directions[angle, 0], directions[angle, 1], 0.0, 0.0)
    span = span_of(edges, wp.min(r, n_r - 1), wp.min(r + 3, n_r - 1), pose, n_x, n_y)
    most = int(cells)
    if 32 % at.members == 0:  # no other tile waits for this one
        most = int(wp.min(most_cells(span), float(cells))) + 1
    across = wp.min(most, at.samples)
    at_once = wp.clamp(at.samples // across, 1, TURNS)
    for first_plane in range(0, wp.max(n_x, n_y), at_once):
        turns = wp.clamp(span.planes - first_plane, 0, at_once)
        for skip in range(0, most, at.samples):
            meet(at.members)
            for turn in range(at.member, turns, at.members):
                window = cells_of(span, first_plane + turn)
                number(at.windows + 2 * turn, True, window[0] + skip)
                number(at.windows + 2 * turn + 1, True, wp.clamp(window[1] - window[0] - skip + 1, 0, across))
            meet(at.members)
            for work in range(at.member, turns * across, at.members):
                turn = work // across
                k = work % across
                if k < number(at.windows + 2 * turn + 1, False, 0):
                    slot = at.slots + samples_before(at.windows, turn) + k
                    plane = first_plane + turn
                    cell = number(at.windows + 2 * turn, False, 0) + k
                    i = wp.where(span.along_y == 1, cell, plane)
                    j = wp.where(span.along_y == 1, plane, cell)
                    x = voxel(i, n_x)
                    y = voxel(j, n_y)
                    ray = footprint(light, n_r, directions, angle, x, y, bent, ratio, strength, fill, sigma, radius)
                    share(slot, -2, four_shares(ray, r, fill, sigma))
                    number(slot, True, (i * n_y + j) * lanes)
            meet(at.members)
            count = samples_before(at.windows, turns)
            t0, t1, t2, t3 = gathered(t0, t1, t2, t3, volume, at, count)
    for i in range(4):
        if r + i < n_r and at.major < n_angle:
            at_column = (angle * n_r + r + i) * lanes + at.lane
            write_four(sinogram, at.slabs, at_column, t0[i], t1[i], t2[i], t3[i])

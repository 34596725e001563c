"""Warp siblings of `ring_table`."""

from __future__ import annotations

import warp as wp

from vamgpu.kernels.footprint_warp import BLURRED, FAR, TAIL, THINNEST, faded
from vamgpu.kernels.wide_warp import Flat, read, write

wp.set_module_options({"enable_backward": False, "fast_math": False})

ROWS = 8
MINOR = 4  # cells that a thread of `ring_pose` computes


@wp.func
def third_integral(x: wp.float64, sigma: wp.float64):
    """Third integral of a Gaussian about 0; with sigma 0, of a point."""
    above = wp.max(x, wp.float64(0.0))
    if sigma == wp.float64(0.0):
        return wp.float64(0.5) * above * above
    t = wp.abs(x) / sigma
    series = t * wp.float64(7.122526186e-05) + wp.float64(2.423642034e-04)
    series = t * series + wp.float64(3.491863407e-03)
    series = t * series + wp.float64(2.202380776e-02)
    series = t * series + wp.float64(9.973836443e-02)
    series = t * series + wp.float64(1.0)
    series = series * series
    series = series * series
    series = series * series
    series = series * series
    tail = wp.float64(0.25) * sigma * sigma / series
    return wp.where(x > wp.float64(0.0), wp.float64(0.5) * (x * x + sigma * sigma) - tail, tail)


@wp.func
def edge(x: wp.float64, outer: wp.float64, inner: wp.float64, sigma: wp.float64):
    """Integral of a cell's blurred trapezoid from −∞ to x, times the areas of its boxes."""
    return (third_integral(x + outer, sigma) + third_integral(x - outer, sigma)) - (
        third_integral(x + inner, sigma) + third_integral(x - inner, sigma)
    )


@wp.func
def shares(u: wp.float64, a: float, b: float, strength: float, fill: float, sigma: float):
    """Light of four neighboring columns in a part of a cell, ``u`` columns beyond the first."""
    least = THINNEST + BLURRED * sigma
    thin = wp.max(wp.min(a, b), least)
    wide = wp.sqrt(wp.max(a * a + b * b - thin * thin, least * least))
    reach = wp.max(0.5 * (wide + thin) + 0.5 * fill + TAIL * sigma, FAR * sigma)
    found = wp.vec4(0.0, 0.0, 0.0, 0.0)
    if strength == 0.0 or float(u) < -reach or float(u) > reach + 3.0:
        return found
    outer = wp.float64(0.5) * (wp.float64(wide) + wp.float64(thin))
    inner = wp.float64(0.5) * (wp.float64(wide) - wp.float64(thin))
    half = wp.float64(0.5) * wp.float64(fill)
    spread = wp.float64(sigma)
    for lane in range(4):
        apart = u - wp.float64(lane)
        light = edge(apart + half, outer, inner, spread) - edge(apart - half, outer, inner, spread)
        counted = faded(float(apart), reach, sigma)
        found[lane] = counted * strength / (wide * thin * fill) * wp.max(float(light), 0.0)
    return found


@wp.kernel
def ring_pose(
    feet: wp.array4d[float], first: int, columns: int, factor: float, fill: float, sigma: float, pose: Flat,
    n_angle: int, n_cell: int, n_foot: int, n_z: int,
) -> None:  # fmt: skip
    slab, angle, tile, lane = wp.tid()
    lanes = pose.shape[1] // (n_angle * n_cell)
    z = 4 * (slab * lanes + lane)
    for cell in range(tile * MINOR, wp.min(tile * MINOR + MINOR, n_cell)):
        total = wp.vec4(0.0, 0.0, 0.0, 0.0)
        for part in range(n_foot):
            u = wp.float64(feet[angle, cell, part, 0] - float(first + z)) + wp.float64(feet[angle, cell, part, 1])
            a = feet[angle, cell, part, 3]
            b = feet[angle, cell, part, 4]
            total += shares(u, a, b, feet[angle, cell, part, 2], fill, sigma)
        for i in range(4):
            if z + i >= columns:
                total[i] = 0.0
        if z == 0:
            total[0] = total[0] * factor
        write(pose, slab, (angle * n_cell + cell) * lanes + lane, total)


@wp.func
def left_by(arc: float, wave: int):
    """Share of a wave that remains after a mean over an arc."""
    x = 0.5 * arc * float(wave)
    return wp.where(x == 0.0, 1.0, wp.sin(x) / wp.where(x == 0.0, 1.0, x))


@wp.kernel
def ring_entries(
    spectrum: Flat, begins: wp.array[int], arcs: wp.array2d[float], columns: int, entries: wp.array[float],
    n_k: int, n_cell: int, n_z: int, n_sample: int, n_entry: int,
) -> None:  # fmt: skip
    slab, k, cell, lane = wp.tid()
    if 2 * k > n_k:
        return
    lanes = spectrum.shape[1] // (n_k * n_cell)
    j = cell // ROWS
    ring = cell % ROWS
    n = n_k * n_sample
    wave = wp.min(k + j * n_k, n - k - j * n_k)
    other_k = n_k - k
    other_j = n_sample - 1 - j
    if k == 0:
        other_k = 0
        other_j = (n_sample - j) % n_sample
    own = read(spectrum, slab, (k * n_cell + cell) * lanes + lane)
    other = read(spectrum, slab, (other_k * n_cell + other_j * ROWS + ring) * lanes + lane)
    left = left_by(arcs[0, ring], wave) * left_by(arcs[1, ring], wave) * 0.5 / float(n)
    z = 4 * (slab * lanes + lane)
    begin = k * (n_entry // (n_k // 2 + 1)) + begins[j] + z * 2 * ROWS + ring
    for i in range(2):
        if z + 2 * i < wp.min(columns, n_z):
            at = begin + i * 4 * ROWS
            entries[at] = left * (own[2 * i] + other[2 * i])
            entries[at + ROWS] = left * (own[2 * i + 1] - other[2 * i + 1])
            entries[at + 2 * ROWS] = left * (own[2 * i + 1] + other[2 * i + 1])
            entries[at + 3 * ROWS] = left * (other[2 * i] - own[2 * i])


@wp.func
def outward(
    steps: wp.array2d[int], pivots: wp.array2d[float], odd: int, beside: float, entries: wp.array[float], start: int,
    head: int, pair: int,
):  # fmt: skip
    """Eliminate the inner neighbor of each ring of a track; return its last tile."""
    next = wp.vec2(0.0, 0.0)
    tile = head
    last = head
    while tile >= 0:
        at = start + steps[tile, 0] + pair * 2 * ROWS
        for i in range(ROWS):
            if pair < steps[tile, 1]:
                inner = steps[tile, 2] + i - 1
                if inner >= 0:
                    next = next * (beside / pivots[inner, odd])
                next = wp.vec2(entries[at + i], entries[at + ROWS + i]) - next
                entries[at + i] = next[0]
                entries[at + ROWS + i] = next[1]
            else:
                next = wp.vec2(0.0, 0.0)
        last = tile
        tile = steps[tile, 6]
    return last


@wp.kernel
def ring_coefficients(
    steps: wp.array2d[int], pivots: wp.array2d[float], angles: int, own: float, beside: float,
    entries: wp.array[float], peaks: wp.array3d[float], n_tile: int, n_ring: int, n_entry: int, n_frequency: int,
    n_block: int,
) -> None:  # fmt: skip
    k, head, block = wp.tid()
    if steps[head, 5] >= 0:
        return
    start = k * (n_entry // n_frequency)
    kappa = k + steps[head, 4] * angles
    odd = kappa & 1
    tile = head
    while tile >= 0:
        peaks[k, tile, block] = 0.0
        tile = steps[tile, 6]
    for pair in range(block * ROWS, (block + 1) * ROWS):
        tile = outward(steps, pivots, odd, beside, entries, start, head, pair)
        next = wp.vec2(0.0, 0.0)
        while tile >= 0:
            at = start + steps[tile, 0] + pair * 2 * ROWS
            wave = 2.0 * wp.pi * float(kappa) / float(angles * steps[tile, 3])
            along = 1.0 / (own + 2.0 * beside * wp.cos(wave))
            most = float(0.0)
            for back in range(ROWS):
                if pair < steps[tile, 1]:
                    i = ROWS - 1 - back
                    next = (wp.vec2(entries[at + i], entries[at + ROWS + i]) - beside * next) / pivots[
                        steps[tile, 2] + i, odd
                    ]
                    entries[at + i] = along * next[0]
                    entries[at + ROWS + i] = along * next[1]
                    most = wp.max(most, wp.dot(next, next))
                else:
                    next = wp.vec2(0.0, 0.0)
            peaks[k, tile, block] = wp.max(peaks[k, tile, block], along * wp.sqrt(most))
            tile = steps[tile, 5]

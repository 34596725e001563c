"""Warp version of `transport`; a thread owns four lanes of z along a run of x and takes one step."""

from __future__ import annotations

import warp as wp

from vamgpu.kernels.wide_warp import Flat, read, read_one, write

wp.set_module_options({"enable_backward": False, "fast_math": False})

TINY = 1.0e-30
NOTHING = 1.0e-20
RUN = 8  # of samples along x that a thread goes through


@wp.func
def same(value: float):
    return wp.vec4(value, value, value, value)


@wp.func
def spread_one(
    s: Flat, spread: wp.array2d[float], walls: wp.array3d[float], species: int, slab: int, x: int, y: int,
    lane: int, lanes: int, passes: wp.vec4, n_x: int, n_y: int, n_z: int,
):  # fmt: skip
    """A species after diffusion; passes holds 1 for the open faces x low, x high, y low, y high."""
    at = (x * n_y + y) * lanes + lane
    here = read(s, slab, at)
    if x > 0:  # noqa: SIM108 - Warp evaluates both sides of a ternary
        x_low = read(s, slab, at - n_y * lanes)
    else:
        x_low = same(walls[species, 0, 0]) + walls[species, 0, 1] * here
    if x + 1 < n_x:  # noqa: SIM108 - Warp evaluates both sides of a ternary
        x_high = read(s, slab, at + n_y * lanes)
    else:
        x_high = same(walls[species, 1, 0]) + walls[species, 1, 1] * here
    if y > 0:  # noqa: SIM108 - Warp evaluates both sides of a ternary
        y_low = read(s, slab, at - lanes)
    else:
        y_low = same(walls[species, 2, 0]) + walls[species, 2, 1] * here
    if y + 1 < n_y:  # noqa: SIM108 - Warp evaluates both sides of a ternary
        y_high = read(s, slab, at + lanes)
    else:
        y_high = same(walls[species, 3, 0]) + walls[species, 3, 1] * here
    if lane > 0:
        last = read_one(s, slab, at - 1, 3)
    elif slab > 0:
        last = read_one(s, slab - 1, at + lanes - 1, 3)
    else:
        last = walls[species, 4, 0] + walls[species, 4, 1] * here[0]
    z_low = wp.vec4(last, here[0], here[1], here[2])
    top = n_z - 1 - 4 * (slab * lanes + lane)
    next = float(0.0)
    if top >= 4:
        behind = lane + 1 == lanes
        next = read_one(s, slab + wp.where(behind, 1, 0), at + 1 - wp.where(behind, lanes, 0), 0)
    z_high = wp.vec4(here[1], here[2], here[3], next)
    if top < 4:
        for k in range(4):  # a known index keeps the vector in registers
            if k == top:
                z_high[k] = walls[species, 5, 0] + walls[species, 5, 1] * here[k]
    out = here + spread[species, 0] * (passes[0] * (x_low - here) + passes[1] * (x_high - here))
    out += spread[species, 1] * (passes[2] * (y_low - here) + passes[3] * (y_high - here))
    return out + spread[species, 2] * ((z_low - here) + (z_high - here))


@wp.func
def settled(value: float):
    return wp.where(value > NOTHING, value, 0.0)


@wp.func
def crossing(when: float, before: float, after: float, level: float, time: float, step: float):
    if before < level and after >= level:
        return time + step * (level - before) / (after - before)
    return when


@wp.func
def passages(open: wp.array2d[wp.uint8], x: int, y: int, n_x: int, n_y: int):
    passes = same(1.0)
    if x > 0:
        passes[0] = float(open[x - 1, y])
    if x + 1 < n_x:
        passes[1] = float(open[x + 1, y])
    if y > 0:
        passes[2] = float(open[x, y - 1])
    if y + 1 < n_y:
        passes[3] = float(open[x, y + 1])
    return passes


@wp.func
def light_spared(
    dose: Flat, optical_time: Flat, mechanical_time: Flat, slab: int, at: int, more: wp.vec4, optical: float,
    mechanical: float, time: float, length: float,
):  # fmt: skip
    """Add the dose of the remaining light, and record when it crosses a threshold."""
    before = read(dose, slab, at)
    after = before + more
    write(dose, slab, at, after)
    seen = read(optical_time, slab, at)
    hard = read(mechanical_time, slab, at)
    for k in range(4):
        seen[k] = crossing(seen[k], before[k], after[k], optical, time, length)
        hard[k] = crossing(hard[k], before[k], after[k], mechanical, time, length)
    write(optical_time, slab, at, seen)
    write(mechanical_time, slab, at, hard)


@wp.kernel
def transport(
    a: Flat, b: Flat, c: Flat, visible: Flat, ultraviolet: Flat, open: wp.array2d[wp.uint8],
    spread: wp.array2d[float], walls: wp.array3d[float], rates: wp.array[float], order: int,
    reacting: int, optical: float, mechanical: float, time: float, steps: int, scratch: wp.array2d[float],
    a_out: Flat, b_out: Flat, c_out: Flat, dose: Flat, optical_time: Flat, mechanical_time: Flat,
    n_x: int, n_y: int, n_z: int, n_part: int, n_room: int,
) -> None:  # fmt: skip
    slab, run, y, lane = wp.tid()
    lanes = a.shape[1] // (n_x * n_y)
    for x in range(RUN * run, wp.min(RUN * run + RUN, n_x)):
        at = (x * n_y + y) * lanes + lane
        if open[x, y] == wp.uint8(0):
            write(a_out, slab, at, read(a, slab, at))
            write(b_out, slab, at, read(b, slab, at))
            write(c_out, slab, at, read(c, slab, at))
        else:
            passes = passages(open, x, y, n_x, n_y)
            va = spread_one(a, spread, walls, 0, slab, x, y, lane, lanes, passes, n_x, n_y, n_z)
            vb = spread_one(b, spread, walls, 1, slab, x, y, lane, lanes, passes, n_x, n_y, n_z)
            vc = spread_one(c, spread, walls, 2, slab, x, y, lane, lanes, passes, n_x, n_y, n_z)
            if reacting != 0:
                uvs = read(ultraviolet, slab, at)
                powers = read(visible, slab, at) + rates[4] * uvs
                more = same(0.0)
                spare = int(0)
                for k in range(4):
                    want_a = rates[0] * powers[k]
                    want_b = rates[1] * powers[k]
                    whole = va[k] + vb[k]
                    most = wp.max(want_a, want_b)
                    share_a = va[k] / wp.max(wp.max(whole, want_a), TINY)
                    share_b = vb[k] / wp.max(wp.max(whole, want_b), TINY)
                    if whole < most:
                        more[k] = wp.max(0.0, 1.0 - share_a - share_b) * powers[k] * rates[5]
                        spare = 1
                    kept_b = settled(vb[k] - want_b * share_b)
                    va[k] = settled(va[k] - want_a * share_a)
                    rate = rates[2] * uvs[k]
                    split = wp.min(vc[k], wp.where(order != 0, vc[k] * rate, rate))
                    paired = rates[3] * kept_b * kept_b / (1.0 + 2.0 * rates[3] * kept_b)
                    vb[k] = settled(kept_b + 2.0 * (split - paired))
                    vc[k] = vc[k] - split + paired
                if spare != 0:
                    light_spared(dose, optical_time, mechanical_time, slab, at, more, optical, mechanical, time,
                                       rates[5])  # fmt: skip
            write(a_out, slab, at, va)
            write(b_out, slab, at, vb)
            write(c_out, slab, at, vc)

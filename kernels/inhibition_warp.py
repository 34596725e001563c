"""Warp version of `inhibition`; a thread owns four lanes of z of one sample."""

from __future__ import annotations

import warp as wp

from vamgpu.kernels.wide_warp import Vectors

wp.set_module_options({"enable_backward": False, "fast_math": False})
MOST = 40


@wp.func
def depletion_substep(a: float, b: float, v: float, alpha: float, floor: float):
    """Decay of A while v arrives: see the definition."""
    h = wp.max(v / (a + b + floor), (v - a - b / alpha) / floor)
    step = float(1.0)
    n = int(0)
    while n < MOST and wp.abs(step) > 3.0e-7 * (0.05 + wp.abs(h)):
        left = wp.exp(-h)
        kept = wp.exp(-alpha * h)
        missing = v - a * (1.0 - left) - b * (1.0 - kept) / alpha - floor * h
        step = missing / (a * left + b * kept + floor)
        h = h + step
        n += 1
    return h


@wp.kernel
def inhibition_step(
    visible: Vectors, ultraviolet: Vectors, visible_gain: float, ultraviolet_gain: float, cross_gain: float,
    alpha: float, pairing: float, floor: float, a: Vectors, b: Vectors, c: Vectors, x: Vectors, a_end: Vectors,
    b_end: Vectors, c_end: Vectors, x_end: Vectors,
    n_i: int, n_j: int, n_z: int,
) -> None:  # fmt: skip
    slab, i, j, lane = wp.tid()
    lights = visible[slab, i, j, lane]
    others = ultraviolet[slab, i, j, lane]
    av = a[slab, i, j, lane]
    bv = b[slab, i, j, lane]
    cv = c[slab, i, j, lane]
    xv = x[slab, i, j, lane]
    for k in range(4):
        kept = wp.exp(-0.5 * ultraviolet_gain * others[k])
        v = visible_gain * lights[k] + cross_gain * others[k]
        b1 = bv[k] + 2.0 * cv[k] * (1.0 - kept)
        b2 = b1 / (1.0 + pairing * b1)
        c2 = cv[k] * kept + 0.5 * (b1 - b2)
        h = depletion_substep(av[k], b2, v, alpha, floor)
        b3 = b2 * wp.exp(-alpha * h)
        b4 = b3 / (1.0 + pairing * b3)
        c4 = c2 + 0.5 * (b3 - b4)
        xv[k] = xv[k] + floor * h
        av[k] = av[k] * wp.exp(-h)
        bv[k] = b4 + 2.0 * c4 * (1.0 - kept)
        cv[k] = c4 * kept
    a_end[slab, i, j, lane] = av
    b_end[slab, i, j, lane] = bv
    c_end[slab, i, j, lane] = cv
    x_end[slab, i, j, lane] = xv


@wp.kernel
def inhibition_adjoint(
    visible: Vectors, ultraviolet: Vectors, visible_gain: float, ultraviolet_gain: float, cross_gain: float,
    alpha: float, pairing: float, floor: float, a: Vectors, b: Vectors, c: Vectors, x_slope: Vectors, a_slope: Vectors,
    b_slope: Vectors, c_slope: Vectors, visible_slope: Vectors, ultraviolet_slope: Vectors,
    n_i: int, n_j: int, n_z: int,
) -> None:  # fmt: skip
    slab, i, j, lane = wp.tid()
    lights = visible[slab, i, j, lane]
    others = ultraviolet[slab, i, j, lane]
    av = a[slab, i, j, lane]
    bv = b[slab, i, j, lane]
    cv = c[slab, i, j, lane]
    xs = x_slope[slab, i, j, lane]
    a_new = a_slope[slab, i, j, lane]
    b_new = b_slope[slab, i, j, lane]
    c_new = c_slope[slab, i, j, lane]
    visible_new = visible_slope[slab, i, j, lane]
    ultraviolet_new = ultraviolet_slope[slab, i, j, lane]
    for k in range(4):
        kept = wp.exp(-0.5 * ultraviolet_gain * others[k])
        split = 1.0 - kept
        v = visible_gain * lights[k] + cross_gain * others[k]
        b1 = bv[k] + 2.0 * cv[k] * split
        d1 = 1.0 / (1.0 + pairing * b1)
        b2 = b1 * d1
        c2 = cv[k] * kept + 0.5 * (b1 - b2)
        h = depletion_substep(av[k], b2, v, alpha, floor)
        left = wp.exp(-h)
        rest = wp.exp(-alpha * h)
        b3 = b2 * rest
        d3 = 1.0 / (1.0 + pairing * b3)
        c4 = c2 + 0.5 * (b3 - b3 * d3)
        lu = 0.5 * kept * c4 * (2.0 * b_new[k] - c_new[k])
        lc = c_new[k] * kept + 2.0 * b_new[k] * split
        lb = b_new[k] * d3 * d3 + 0.5 * lc * (1.0 - d3 * d3)
        lv = (floor * xs[k] - a_new[k] * av[k] * left - alpha * lb * b3) / (av[k] * left + b3 + floor)
        a_new[k] = a_new[k] * left - lv * (1.0 - left)
        lb = lb * rest - lv * (1.0 - rest) / alpha
        lb = lb * d1 * d1 + 0.5 * lc * (1.0 - d1 * d1)
        lu = lu + 0.5 * kept * cv[k] * (2.0 * lb - lc)
        b_new[k] = lb
        c_new[k] = lc * kept + 2.0 * lb * split
        visible_new[k] = visible_new[k] + visible_gain * lv
        ultraviolet_new[k] = ultraviolet_new[k] + ultraviolet_gain * lu + cross_gain * lv
    a_slope[slab, i, j, lane] = a_new
    b_slope[slab, i, j, lane] = b_new
    c_slope[slab, i, j, lane] = c_new
    visible_slope[slab, i, j, lane] = visible_new
    ultraviolet_slope[slab, i, j, lane] = ultraviolet_new


@wp.kernel
def take_poses(light: Vectors, first: int, part: Vectors, n_angle: int, n_r: int, n_z: int, n_pose: int) -> None:
    slab, pose, j, lane = wp.tid()
    part[slab, pose, j, lane] = light[slab, first + pose, j, lane]


@wp.kernel
def put_poses(part: Vectors, first: int, light: Vectors, n_pose: int, n_r: int, n_z: int, n_angle: int) -> None:
    slab, pose, j, lane = wp.tid()
    light[slab, first + pose, j, lane] = part[slab, pose, j, lane]

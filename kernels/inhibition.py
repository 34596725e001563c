"""Photoinhibition of every voxel by a short run of angles, in closed form, and its exact adjoint."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from vamgpu.kernels.pointwise import CPU, pointwise
from vamgpu.kernels.signature import Array, ArrayInOut, ArrayOut, Field, Integer, Real, SinogramOut, kernel

MOST = 40
"""Greatest number of steps of Newton's method."""
LEAST = 1e-6
"""Share of oxygen that counts as none."""

Part = Annotated[np.ndarray, Field(("pose", "r", "z"))]


def depletion_substep(a: np.ndarray, b: np.ndarray, v: np.ndarray, alpha: float, floor: float) -> np.ndarray:
    """h with a(1 − e^−h) + b(1 − e^−αh)/α + floor·h = v: A decays to e^−h while v arrives."""
    # The function is concave and both first bounds lie below its root: Newton's method rises to it.
    h = np.maximum(v / (a + b + floor), (v - a - b / alpha) / floor)
    for _ in range(MOST):
        left, kept = np.exp(-h), np.exp(-alpha * h)
        step = (v - a * (1.0 - left) - b * (1.0 - kept) / alpha - floor * h) / (a * left + b * kept + floor)
        h = h + step
        if np.all(~(np.abs(step) > 3e-7 * (0.05 + np.abs(h)))):  # NaN is done, too
            break
    return h


@pointwise(over="a_end")
def inhibition_step(
    visible: Array, ultraviolet: Array, visible_gain: Real, ultraviolet_gain: Real, cross_gain: Real, alpha: Real,
    pairing: Real, floor: Real, a: Array, b: Array, c: Array, x: Array,
    a_end: ArrayOut, b_end: ArrayOut, c_end: ArrayOut, x_end: ArrayOut,
) -> None:  # fmt: skip
    """The state after a step; output arrays may be the input arrays."""
    # visible, ultraviolet: exposures. v: share of A's induction that arrives. Each half of the ultraviolet light leaves
    # the share ``kept`` of C. pairing: k₂·[A]₀·time.
    v = visible_gain * visible + cross_gain * ultraviolet
    kept = np.exp(-0.5 * ultraviolet_gain * ultraviolet)
    b1, c1 = b + 2.0 * c * (1.0 - kept), c * kept
    b2 = b1 / (1.0 + pairing * b1)
    c2 = c1 + 0.5 * (b1 - b2)
    h = depletion_substep(a, b2, v, alpha, floor)
    b3 = b2 * np.exp(-alpha * h)
    b4 = b3 / (1.0 + pairing * b3)
    c4 = c2 + 0.5 * (b3 - b4)
    x_end[...] = x + floor * h
    a_end[...] = a * np.exp(-h)
    b_end[...] = b4 + 2.0 * c4 * (1.0 - kept)
    c_end[...] = c4 * kept


@pointwise(over="a_slope")
def inhibition_adjoint(
    visible: Array, ultraviolet: Array, visible_gain: Real, ultraviolet_gain: Real, cross_gain: Real, alpha: Real,
    pairing: Real, floor: Real, a: Array, b: Array, c: Array, x_slope: Array,
    a_slope: ArrayInOut, b_slope: ArrayInOut, c_slope: ArrayInOut,
    visible_slope: ArrayInOut, ultraviolet_slope: ArrayInOut,
) -> None:  # fmt: skip
    """Replace derivatives by the state after a step (a, b, c) by those by the state before; add those by exposures."""
    v = visible_gain * visible + cross_gain * ultraviolet
    kept = np.exp(-0.5 * ultraviolet_gain * ultraviolet)
    b1, c1 = b + 2.0 * c * (1.0 - kept), c * kept
    d1 = 1.0 / (1.0 + pairing * b1)
    b2 = b1 * d1
    c2 = c1 + 0.5 * (b1 - b2)
    h = depletion_substep(a, b2, v, alpha, floor)
    left, rest = np.exp(-h), np.exp(-alpha * h)
    b3 = b2 * rest
    d3 = 1.0 / (1.0 + pairing * b3)
    c4 = c2 + 0.5 * (b3 - b3 * d3)
    la, lb, lc = a_slope, b_slope, c_slope
    lu = 0.5 * kept * c4 * (2.0 * lb - lc)
    lc = lc * kept + 2.0 * lb * (1.0 - kept)
    lb = lb * d3 * d3 + 0.5 * lc * (1.0 - d3 * d3)
    lv = (floor * x_slope - la * a * left - alpha * lb * b3) / (a * left + b3 + floor)
    la = la * left - lv * (1.0 - left)
    lb = lb * rest - lv * (1.0 - rest) / alpha
    lb = lb * d1 * d1 + 0.5 * lc * (1.0 - d1 * d1)
    lu = lu + 0.5 * kept * c * (2.0 * lb - lc)
    a_slope[...], b_slope[...] = la, lb
    c_slope[...] = lc * kept + 2.0 * lb * (1.0 - kept)
    visible_slope += visible_gain * lv
    ultraviolet_slope += ultraviolet_gain * lu + cross_gain * lv


@pointwise(over="peak")
def raise_peak(a: Array, b: Array, x: Array, alpha: Real, number: Real, peak: ArrayInOut, when: ArrayInOut) -> None:
    """peak = the greatest effective dose x − a − b/alpha so far; when = the last step, from 0 on, that raised it."""
    dose = x - a - b / alpha
    when[...] = np.maximum(when, np.where(dose > peak, number, -1.0))
    peak[...] = np.maximum(dose, peak)


@pointwise(over="a_slope")
def add_peak_slope(
    slope: Array, when: Array, number: Real, alpha: Real, a_slope: ArrayInOut, b_slope: ArrayInOut, x_slope: ArrayInOut
) -> None:
    """Add derivatives with respect to the peak to those with respect to the state after the step that made it."""
    own = np.where(when == number, slope, 0.0)
    a_slope -= own
    b_slope -= own / alpha
    x_slope += own


def oxygen_left(a: np.ndarray, v: np.ndarray, floor: float) -> np.ndarray:
    """Oxygen after an exposure v of the oxygen a."""
    z = np.maximum((a - v) / floor + np.log(a / floor), -60.0)
    low = np.exp(np.minimum(z, 0.0))
    w = np.where(z > 0.0, z + 0.567 - np.log(1.0 + np.maximum(z, 0.0)), low / (1.0 + 0.76 * low))
    for _ in range(2):
        missing, ahead = z - w - np.log(w), 1.0 + w
        pull = ahead * (ahead + missing / 1.5)
        w = w * (1.0 + missing / ahead * (pull - 0.5 * missing) / (pull - missing))
    return floor * w


@pointwise(over="used_end")
def oxygen_step(
    dose: Array, gain: Real, floor: Real, used: Array, x: Array, used_end: ArrayOut, x_end: ArrayOut
) -> None:  # fmt: skip
    """Used oxygen and X after the exposure gain·dose of oxygen alone; the end may be the beginning."""
    v, before = gain * dose, np.maximum(1.0 - used, LEAST)
    left = oxygen_left(before, v, floor)
    used_end[...], x_end[...] = 1.0 - left, x + (v - (before - left))


@pointwise(over="used_slope")
def oxygen_adjoint(
    dose: Array, gain: Real, floor: Real, used: Array, x_slope: Array, used_slope: ArrayInOut, dose_slope: ArrayInOut
) -> None:  # fmt: skip
    """Derivatives by the oxygen used after a step become those by that before it; those by the dose are added."""
    before = np.maximum(1.0 - used, LEAST)
    left = oxygen_left(before, gain * dose, floor)
    share = left / before
    by_v = (floor * x_slope + left * used_slope) / (left + floor)
    used_slope[...] = np.where(1.0 - used > LEAST, share * used_slope + (1.0 - share) * by_v, 0.0)
    dose_slope += gain * by_v


@pointwise(over="a")
def consume_oxygen(dose: Array, gain: Real, floor: Real, a: ArrayInOut, x: ArrayInOut) -> None:
    """An implicit Euler step of the exposure gain·dose: the oxygen a falls by v·a/(a + floor), X rises by the rest."""
    v = gain * dose
    half = 0.5 * (a - v - floor)
    root = np.sqrt(half * half + floor * a)
    left = np.where(half > 0.0, half + root, floor * a / np.where(half > 0.0, 1.0, root - half))
    x += v - (a - left)
    a[...] = left


@kernel(over="part", cpu=CPU)
def take_poses(
    light: Annotated[np.ndarray, Field(("angle", "r", "z"))],
    first: Integer,
    part: Annotated[np.ndarray, Field(("pose", "r", "z"), writes=True)],
) -> None:
    """part = light from angle ``first`` on."""
    part[...] = light[int(first) : int(first) + len(part)]


@kernel(over="part", cpu=CPU)
def put_poses(part: Part, first: Integer, light: SinogramOut) -> None:
    """light from angle ``first`` on = part; the other angles do not change."""
    light[int(first) : int(first) + len(part)] = part

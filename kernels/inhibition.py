"""Photoinhibition of every voxel by a short run of angles, in closed form, and its exact adjoint.

Concentrations are shares of [A]₀, exposures shares of the induction. A step is split symmetrically (Strang): half the
ultraviolet, half the pairing, all of the visible light, half the pairing, half the ultraviolet. Each piece is solved
exactly: nothing goes below 0, [B] + 2[C] changes only by the B that visible light consumes, and X − [A] − [B]/α rises
by the visible exposure, up to rounding.

Eqs 5-6 of the paper on binary photoinhibition are not smooth where [A] + [B] = 0. In this model, radicals are divided
among A, B and a floor ε, the monomer: d[A]/dv = −[A]/([A] + [B] + ε), d[B]/dv = −α[B]/(…), and X, the monomer's share,
rises by ε/(…). ε → 0 gives eqs 5-6, with X the exposure after the event.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np

from vamgpu.kernels.signature import Array, ArrayInOut, ArrayOut, Field, Integer, Real, SinogramOut, Tiling, kernel

CPU = Tiling(major=1, minor=0)
GPU = Tiling(major=1, minor=1)
MOST = 40
"""Greatest number of steps of Newton's method."""

Part = Annotated[np.ndarray, Field(("pose", "r", "z"))]


def depletion_substep(a: np.ndarray, b: np.ndarray, v: np.ndarray, alpha: float, floor: float) -> np.ndarray:
    """h with a(1 − e^−h) + b(1 − e^−αh)/α + floor·h = v: A decays to e^−h while v arrives.

    Both initial bounds lie below the root of this concave function; Newton's method therefore rises to it.
    """
    h = np.maximum(v / (a + b + floor), (v - a - b / alpha) / floor)
    for _ in range(MOST):
        left, kept = np.exp(-h), np.exp(-alpha * h)
        step = (v - a * (1.0 - left) - b * (1.0 - kept) / alpha - floor * h) / (a * left + b * kept + floor)
        h += step
        if np.all(np.abs(step) <= 1e-14 * (1.0 + np.abs(h))):
            break
    return h


@kernel(over="a_end", cpu=CPU, gpu=GPU)
def inhibition_step(
    visible: Array, ultraviolet: Array, visible_gain: Real, ultraviolet_gain: Real, cross_gain: Real, alpha: Real,
    pairing: Real, floor: Real, a: Array, b: Array, c: Array, x: Array,
    a_end: ArrayOut, b_end: ArrayOut, c_end: ArrayOut, x_end: ArrayOut,
) -> None:  # fmt: skip
    """The state after a step; the arrays of the end may be those of the beginning.

    visible, ultraviolet: exposures.  The share of A's induction that arrives is visible_gain·visible +
    cross_gain·ultraviolet; ultraviolet light splits the share 1 − exp(−ultraviolet_gain·ultraviolet) of C. pairing:
    k₂·[A]₀·time.
    """
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


@kernel(over="a_slope", cpu=CPU, gpu=GPU)
def inhibition_adjoint(
    visible: Array, ultraviolet: Array, visible_gain: Real, ultraviolet_gain: Real, cross_gain: Real, alpha: Real,
    pairing: Real, floor: Real, a: Array, b: Array, c: Array, x_slope: Array,
    a_slope: ArrayInOut, b_slope: ArrayInOut, c_slope: ArrayInOut,
    visible_slope: ArrayInOut, ultraviolet_slope: ArrayInOut,
) -> None:  # fmt: skip
    """Derivatives by the state after a step (a, b and c) become those by the state before it.

    Derivatives by the exposures are added to visible_slope and ultraviolet_slope; the derivative by X does not change.
    """
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
    la, lb, lc = a_slope.copy(), b_slope.copy(), c_slope.copy()
    lu = 0.5 * kept * c4 * (2.0 * lb - lc)
    lc = lc * kept + 2.0 * lb * (1.0 - kept)
    lb = lb * d3 * d3 + 0.5 * lc * (1.0 - d3 * d3)
    lv = (floor * x_slope - la * a * left - alpha * lb * b3) / (a * left + b3 + floor)
    la = la * left - lv * (1.0 - left)
    lb = lb * rest - lv * (1.0 - rest) / alpha
    lb = lb * d1 * d1 + 0.5 * lc * (1.0 - d1 * d1)
    lu += 0.5 * kept * c * (2.0 * lb - lc)
    a_slope[...], b_slope[...] = la, lb
    c_slope[...] = lc * kept + 2.0 * lb * (1.0 - kept)
    visible_slope += visible_gain * lv
    ultraviolet_slope += ultraviolet_gain * lu + cross_gain * lv


@kernel(over="part", cpu=CPU, gpu=GPU)
def take_poses(
    light: Annotated[np.ndarray, Field(("angle", "r", "z"))],
    first: Integer,
    part: Annotated[np.ndarray, Field(("pose", "r", "z"), writes=True)],
) -> None:
    """part = light from angle ``first`` on."""
    part[...] = light[int(first) : int(first) + len(part)]


@kernel(over="part", cpu=CPU, gpu=GPU)
def put_poses(part: Part, first: Integer, light: SinogramOut) -> None:
    """light from angle ``first`` on = part; the other angles do not change."""
    light[int(first) : int(first) + len(part)] = part

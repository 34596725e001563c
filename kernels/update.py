"""Elementwise steps of optimizers, in place if the name of an argument says so."""

from __future__ import annotations

import numpy as np

from vamgpu.kernels.pointwise import Parts, add_up, near_axis, pointwise
from vamgpu.kernels.signature import Array, ArrayInOut, ArrayOut, Integer, Real


@pointwise(over="out")
def linear(a: Real, x: Array, b: Real, y: Array, floor: Real, out: ArrayOut) -> None:
    """out = max(floor, a·x + b·y); out may be x or y."""
    out[...] = np.maximum(floor, a * x + b * y)


@pointwise(over="out")
def multiply(x: Array, y: Array, out: ArrayOut) -> None:
    """out = x·y; out may be x or y."""
    out[...] = x * y


@pointwise(over="gradient")
def apply_penalty(
    light: Array, weight: Real, power: Real, hold: Integer, most: Real, gradient: ArrayInOut, parts: Parts
) -> None:
    """Add the derivative of weight·light^power to the gradient, then, with ``hold``, keep light in 0 to ``most``."""
    # Σ parts = weight·Σ max(0, light)^power. The gradient becomes 0 where a step against it would make dark light (≤ 0)
    # negative, or the brightest light (≥ most) brighter; a filter or a metric applied to the rest then keeps it a
    # direction of descent. power ≥ 1. Source: D. Bertsekas, SIAM J. Control Optim. 20 (1982) 221.
    lit = np.maximum(light, 0.0) if weight else 0.0
    root = weight * np.power(lit, power - 1.0)
    add_up(parts, root * lit)
    slope = gradient + power * root
    held = np.where(light <= 0.0, np.minimum(slope, 0.0), np.where(light >= most, np.maximum(slope, 0.0), slope))
    gradient[...] = held if hold else slope


@pointwise(over="model")
def fill_background(target: Array, low: Real, high: Real, reach: Real, model: ArrayOut) -> None:
    """model = low + (high − low)·target within ``reach`` samples of the axis, 0 beyond."""
    model[...] = np.where(near_axis(model, reach), low + (high - low) * target, 0.0)


@pointwise(over="model")
def correct_by_ratio(
    dose: Array, scale: Real, target: Array, low: Real, high: Real, most: Real, model: ArrayInOut
) -> None:
    """model ·= goal / (scale·dose), the ratio at most ``most``; goal = low + (high − low)·target."""
    goal = low + (high - low) * target
    floor = goal / most
    model *= np.minimum(most, goal / np.maximum(np.maximum(dose * scale, floor), 1e-30))


@pointwise(over="model")
def correct_by_difference(
    dose: Array, scale: Real, target: Array, low: Real, high: Real, gain_outside: Real, gain_inside: Real, reach: Real,
    model: ArrayInOut,
) -> None:  # fmt: skip
    """Lower the model where a void has more than ``low``, raise it where the part has less than ``high``."""
    # A voxel is inside if its target is at least one half; dose is multiplied by scale, the differences by their gain.
    missing, excess = np.maximum(0.0, high - dose * scale), np.maximum(0.0, dose * scale - low)
    change = np.where(target >= 0.5, gain_inside * missing, -gain_outside * excess)
    model += np.where(near_axis(model, reach), change, 0.0)

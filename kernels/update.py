"""Elementwise steps of optimizers, in place if the name of an argument says so."""

from __future__ import annotations

import numpy as np

from vamgpu.kernels.reduce import CPU, Parts, disc
from vamgpu.kernels.reduce import GPU as PARTIAL
from vamgpu.kernels.signature import Array, ArrayInOut, ArrayOut, Integer, Real, Tiling, kernel

GPU = Tiling(major=1, minor=1)


@kernel(over="out", cpu=CPU, gpu=GPU)
def linear(a: Real, x: Array, b: Real, y: Array, floor: Real, out: ArrayOut) -> None:
    """out = max(floor, a·x + b·y); out may be x or y."""
    out[...] = np.maximum(floor, a * x + b * y)


@kernel(over="out", cpu=CPU, gpu=GPU)
def multiply(x: Array, y: Array, out: ArrayOut) -> None:
    """out = x·y; out may be x or y."""
    out[...] = x * y


@kernel(over="gradient", cpu=CPU, gpu=PARTIAL)
def apply_penalty(
    light: Array, weight: Real, power: Real, hold: Integer, most: Real, gradient: ArrayInOut, parts: Parts
) -> None:
    """Add the derivative of weight·light^power to the gradient, then, with ``hold``, keep light within 0 and ``most``.

    Σ parts = weight·Σ max(0, light)^power. The gradient becomes 0 where a step against it would make dark light (≤ 0)
    negative, or the brightest light (≥ most) brighter; a filter or a metric applied to the rest then keeps it a
    direction of descent. power ≥ 1. Source: D. Bertsekas, SIAM J. Control Optim. 20 (1982) 221.
    """
    lit = np.maximum(light, 0.0)
    parts[...] = 0.0
    parts[0] = weight * np.sum(lit**power)
    gradient += weight * power * lit ** (power - 1)
    if hold:
        gradient[((light <= 0) & (gradient > 0)) | ((light >= most) & (gradient < 0))] = 0.0


@kernel(over="model", cpu=CPU, gpu=GPU)
def fill_background(target: Array, low: Real, high: Real, reach: Real, model: ArrayOut) -> None:
    """model = low + (high − low)·target within ``reach`` samples of the axis, 0 beyond."""
    model[...] = (low + (high - low) * target) * disc(model.shape[0], model.shape[1], reach)[:, :, None]


@kernel(over="model", cpu=CPU, gpu=GPU)
def correct_by_ratio(
    dose: Array, scale: Real, target: Array, low: Real, high: Real, most: Real, model: ArrayInOut
) -> None:
    """model ·= goal / (scale·dose), the ratio within 1/most … most; goal = low + (high − low)·target."""
    goal = low + (high - low) * target
    floor = goal / most
    model *= np.minimum(most, goal / np.maximum(np.maximum(dose * scale, floor), 1e-30))


@kernel(over="model", cpu=CPU, gpu=GPU)
def correct_by_difference(
    dose: Array, scale: Real, target: Array, low: Real, high: Real, gain_outside: Real, gain_inside: Real, reach: Real,
    model: ArrayInOut,
) -> None:  # fmt: skip
    """Lower the model where a void has more than ``low``, raise it where the part has less than ``high``.

    A voxel is inside if its target is at least one half; dose is multiplied by scale, the differences by their gain.
    """
    inside = target >= 0.5
    near = disc(model.shape[0], model.shape[1], reach)[:, :, None]
    model += np.where(inside, gain_inside * np.maximum(0.0, high - dose * scale), 0.0) * near
    model -= np.where(inside, 0.0, gain_outside * np.maximum(0.0, dose * scale - low)) * near

"""Losses of a dose, voxel by voxel, and their derivatives."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from vamgpu.kernels.pointwise import Parts, add_up, look_up, near_axis, pointwise
from vamgpu.kernels.signature import Array, ArrayInOut, Integer, Real, Table

Response = Annotated[np.ndarray, Table("float32", ("sample",))]
Weights = Annotated[np.ndarray, Table("float32", ("j",))]


@pointwise(over="dose")
def band_loss(
    dose: ArrayInOut, target: Array, weight: Array, weighted: Integer, response: Response, start: Real, density: Real,
    low: Real, high: Real, slack_low: Real, slack_high: Real, gain_low: Real, gain_high: Real, power: Real, ridge: Real,
    binary: Integer, reach: Real, parts: Parts,
) -> None:  # fmt: skip
    """Σ parts = Σ w·e^p + ridge·M² with e = max(0, |M − c| − ε); dose becomes ∂(Σ parts)/∂dose."""
    # M = response(dose), sampled as in `look_up`. c = low + (high − low)·f, and so are ε and the gain in w; f is the
    # target, or with ``binary`` whether it is at least one half. w = gain·weight (if ``weighted``), 0 beyond ``reach``.
    f = np.where(target >= 0.5, 1.0, 0.0) if binary else target
    value, slope = look_up(dose, response, start, density)
    difference = value - (low + (high - low) * f)
    excess = np.abs(difference) - (slack_low + (slack_high - slack_low) * f)
    near, gain = near_axis(dose, reach), gain_low + (gain_high - gain_low) * f
    gain = gain * weight if weighted else gain
    excess = np.where((excess > 0.0) & (gain != 0.0), excess, 0.0)  # infinite doses may have no weight
    root = np.where(excess > 0.0, gain * np.power(np.maximum(excess, 1e-30), power - 1.0), 0.0)
    kept = value if ridge else 0.0
    pull = power * np.where(difference < 0.0, -root, root) + 2.0 * ridge * kept
    add_up(parts, np.where(near, root * excess + ridge * kept * kept, 0.0))
    dose[...] = np.where(near, pull * slope * density, 0.0)


@pointwise(over="dose")
def sampled_loss(
    dose: ArrayInOut, target: Array, weight: Array, weighted: Integer, outer: Response, inner: Response, start: Real,
    density: Real, binary: Integer, reach: Real, parts: Parts,
) -> None:  # fmt: skip
    """Σ parts = Σ w·((1 − f)·outer(dose) + f·inner(dose)); dose becomes ∂(Σ parts)/∂dose."""
    # Both are sampled like a response; f and w are those of `band_loss`, with a gain of 1.
    f = np.where(target >= 0.5, 1.0, 0.0) if binary else target
    near, gain = near_axis(dose, reach), weight if weighted else 1.0
    value, slope = look_up(dose, outer, start, density)
    within, steep = look_up(dose, inner, start, density)
    add_up(parts, np.where(near, gain * (value + (within - value) * f), 0.0))
    dose[...] = np.where(near, gain * (slope + (steep - slope) * f) * density, 0.0)


@pointwise(over="dose")
def ramp_loss(
    dose: ArrayInOut, target: Array, weight: Array, weighted: Integer, outside: Real, inside: Real, most: Real,
    hold: Integer, reach: Real, parts: Parts, slopes: Parts, bends: Parts,
) -> None:  # fmt: skip
    """Σ parts = Σ w·e²/2; dose becomes ∂(Σ parts)/∂dose, unless ``hold``."""
    # target: 0 one width outside the surface, 1 one width inside it, linear between. The threshold is t = outside +
    # (inside − outside)·target. For a target of at least one half, e is the amount by which a dose is below t or above
    # ``most``; otherwise by which it is above t. w = weight if ``weighted``, else 1, and 0 beyond ``reach``. Σ slopes,
    # Σ bends: first and second derivative as inside and most rise and outside falls by as much.
    rise, part, off = 2.0 * target - 1.0, target >= 0.5, dose - (outside + (inside - outside) * target)
    short = np.where(part, np.minimum(off, 0.0), np.maximum(off, 0.0))
    over = np.where(part, np.maximum(dose - most, 0.0), 0.0)
    near, gain, error = near_axis(dose, reach), weight if weighted else 1.0, short + over
    add_up(parts, np.where(near, 0.5 * gain * error * error, 0.0))
    add_up(slopes, np.where(near, -gain * (rise * short + over), 0.0))
    bend = np.where(short != 0.0, rise * rise, 0.0) + np.where(over > 0.0, 1.0, 0.0)
    add_up(bends, np.where(near, gain * bend, 0.0))
    slope = np.where(near, gain * error, 0.0)
    dose[...] = dose if hold else slope


@pointwise(over="dose")
def dark_loss(dose: ArrayInOut, weight: Weights, most: Real, parts: Parts) -> None:
    """Σ parts = Σ w·e²/2 with e = max(0, dose − most); dose becomes ∂(Σ parts)/∂dose."""
    # weight: w of each row of samples.
    over = np.maximum(dose - most, 0.0)
    slope = weight[:, None] * over
    add_up(parts, 0.5 * slope * over)
    dose[...] = slope

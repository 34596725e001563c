"""Losses of a dose, voxel by voxel, and their derivatives.

`band_loss` measures how far a dose lies outside the band that the target sets. Source: the band constraint Lp norm,
C. C. Li et al., Additive Manufacturing (2024) 104447. With wide bands and the identity as response, it is the
two-threshold loss. `sampled_loss` computes any loss of a dose, given by samples of it. `ramp_loss` is the two-threshold
loss whose thresholds ramp across the surface of the part; `dark_loss` is that of resin outside the part.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np

from vamgpu.kernels.reduce import CPU, GPU, Parts, disc
from vamgpu.kernels.signature import Array, ArrayInOut, Integer, Real, Table, kernel

Response = Annotated[np.ndarray, Table("float32", ("sample",))]
Weights = Annotated[np.ndarray, Table("float32", ("j",))]


def look_up(dose: np.ndarray, samples: np.ndarray, start: float, density: float) -> tuple[np.ndarray, np.ndarray]:
    """Samples at a dose, interpolated linearly and continued beyond the ends, and the increase to the next."""
    position = (dose - start) * density
    cell = np.clip(np.floor(position).astype(int), 0, len(samples) - 2)
    rise = samples[cell + 1] - samples[cell]
    return samples[cell] + rise * (position - cell), rise


@kernel(over="dose", cpu=CPU, gpu=GPU)
def band_loss(
    dose: ArrayInOut, target: Array, weight: Array, weighted: Integer, response: Response, start: Real, density: Real,
    low: Real, high: Real, slack_low: Real, slack_high: Real, gain_low: Real, gain_high: Real, power: Real, ridge: Real,
    binary: Integer, reach: Real, parts: Parts,
) -> None:  # fmt: skip
    """Σ parts = Σ w·e^p + ridge·M² with e = max(0, |M − c| − ε); dose is overwritten by the derivative by dose.

    M = response(dose), sampled from ``start`` on with ``density`` samples per unit, and straight beyond its ends. c =
    low + (high − low)·f; ε and the gain in w vary from their low to their high value in the same way. f is the target,
    or with ``binary`` whether it is at least one half. w = gain · weight (if ``weighted``), and 0 farther than
    ``reach`` samples from the axis.
    """
    f = np.where(target >= 0.5, 1.0, 0.0) if binary else target
    value, slope = look_up(dose, response, start, density)
    difference = value - (low + (high - low) * f)
    excess = np.abs(difference) - (slack_low + (slack_high - slack_low) * f)
    near = disc(dose.shape[0], dose.shape[1], reach)[:, :, None]
    gain = (gain_low + (gain_high - gain_low) * f) * near
    gain = np.where(excess > 0, gain * weight if weighted else gain, 0.0)
    excess = np.maximum(excess, 1e-30)
    parts[...] = 0.0
    parts[0] = np.sum(gain * excess**power + ridge * value**2 * near)
    pull = gain * power * excess ** (power - 1) * np.sign(difference) + 2.0 * ridge * value * near
    dose[...] = pull * slope * density


@kernel(over="dose", cpu=CPU, gpu=GPU)
def sampled_loss(
    dose: ArrayInOut, target: Array, weight: Array, weighted: Integer, outer: Response, inner: Response, start: Real,
    density: Real, binary: Integer, reach: Real, parts: Parts,
) -> None:  # fmt: skip
    """Σ parts = Σ w·((1 − f)·outer(dose) + f·inner(dose)); dose is overwritten by the derivative by dose.

    Both are sampled like a response. f is the target, or with ``binary`` whether it is at least one half; w = weight if
    ``weighted``, else 1, and 0 farther than ``reach`` samples from the axis.
    """
    f = np.where(target >= 0.5, 1.0, 0.0) if binary else target
    near = disc(dose.shape[0], dose.shape[1], reach)[:, :, None]
    gain = near * weight if weighted else near * 1.0
    (value, slope), (within, steep) = (look_up(dose, samples, start, density) for samples in (outer, inner))
    parts[...] = 0.0
    parts[0] = np.sum(gain * (value + (within - value) * f))
    dose[...] = gain * (slope + (steep - slope) * f) * density


@kernel(over="dose", cpu=CPU, gpu=GPU)
def ramp_loss(
    dose: ArrayInOut, target: Array, weight: Array, weighted: Integer, outside: Real, inside: Real, most: Real,
    reach: Real, parts: Parts,
) -> None:  # fmt: skip
    """Σ parts = Σ w·e²/2; dose is overwritten by the derivative by dose.

    target: 0 one width outside the surface, 1 one width inside it, linear between. The threshold is t = outside +
        (inside − outside)·target. For a target of at least one half, e is the amount by which a dose is below t or
        above ``most``; otherwise by which it is above t. w = weight if ``weighted``, else 1, and 0 beyond ``reach``.
    """
    threshold = outside + (inside - outside) * target
    error = np.where(
        target >= 0.5,
        np.minimum(dose - threshold, 0.0) + np.maximum(dose - most, 0.0),
        np.maximum(dose - threshold, 0.0),
    )
    near = disc(dose.shape[0], dose.shape[1], reach)[:, :, None]
    gain = near * weight if weighted else near * 1.0
    parts[...] = 0.0
    parts[0] = 0.5 * np.sum(gain * error**2)
    dose[...] = gain * error


@kernel(over="dose", cpu=CPU, gpu=GPU)
def dark_loss(dose: ArrayInOut, weight: Weights, most: Real, parts: Parts) -> None:
    """Σ parts = Σ w·e²/2 with e = max(0, dose − most); dose is overwritten by the derivative by dose.

    weight: w of each row of samples.
    """
    over = np.maximum(dose - most, 0.0)
    parts[...] = 0.0
    parts[0] = 0.5 * np.sum(weight[:, None] * over**2)
    dose[...] = weight[:, None] * over

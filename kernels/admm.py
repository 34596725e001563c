"""Steps of ADMM on dose and light; see `vamgpu.methods.two_levels`."""

from __future__ import annotations

import numpy as np

from vamgpu.kernels.pointwise import Parts, add_up, near_axis, pointwise
from vamgpu.kernels.signature import Array, ArrayInOut, ArrayOut, Real


def counted(target: np.ndarray, reach: float, rim: float) -> np.ndarray:
    """Weights of voxels."""
    return np.where(near_axis(target, reach), 1.0, np.where(target >= 0.5, 0.0, rim))


@pointwise(over="held")
def find_levels(
    held: Array, scaled_dual: Array, target: Array, least: Real, leak: Real, reach: Real, rim: Real, below: Parts,
    shorts: Parts, above: Parts, over: Parts,
) -> None:  # fmt: skip
    """Number of part voxels below the least dose and their deficit, of doses clipped to 1; voids above the leak."""
    weight, dose = counted(target, reach, rim), 2.0 * held + scaled_dual
    lacks = np.where(target >= 0.5, least - np.minimum(dose, 1.0), 0.0)
    leaks = np.where(target < 0.5, dose - leak, 0.0)
    add_up(below, np.where(lacks > 0.0, weight, 0.0))
    add_up(shorts, weight * np.maximum(lacks, 0.0))
    add_up(above, np.where(leaks > 0.0, weight, 0.0))
    add_up(over, weight * np.maximum(leaks, 0.0))


@pointwise(over="pull")
def clip_dose(
    held: Array, target: Array, least: Real, leak: Real, relax: Real, reach: Real, rim: Real, scaled_dual: ArrayInOut,
    pull: ArrayOut,
) -> None:  # fmt: skip
    """pull = the dose clipped to its limits, over-relaxed by ``relax``, minus the reflected dose."""
    # Limits are least to 1 inside, at most leak outside; scaled_dual is updated.
    dose = 2.0 * held + scaled_dual
    within = np.where(target >= 0.5, np.maximum(np.minimum(dose, 1.0), least), np.minimum(dose, leak))
    beyond = relax * within + (1.0 - relax) * held
    pull[...] = counted(target, reach, rim) * (beyond - dose)
    scaled_dual[...] = dose - held - beyond


@pointwise(over="light")
def clip_light(
    light: Array, white: Array, push: Real, base: Real, relax: Real, scaled_dual: ArrayInOut, pull: ArrayInOut
) -> None:
    """pull += base·(the light clipped to 0…white, over-relaxed by ``relax``, minus the reflected light)."""
    # Light is driven to both limits by push times its distance from their middle; scaled_dual is updated.
    bright = 2.0 * light + scaled_dual
    driven = bright + push * (bright - 0.5 * white)
    beyond = relax * np.clip(driven, 0.0, white) + (1.0 - relax) * light
    pull[...] += base * (beyond - bright)
    scaled_dual[...] = bright - light - beyond

"""Steps of ADMM on dose and light; see `vamgpu.methods.two_levels`.

Source: J. Eckstein, D. P. Bertsekas, Math. Program. 55 (1992) 293. A voxel is inside if its target is at least one
half. Farther than ``reach`` samples from the axis, voids have the weight ``rim``: they are not judged, but should stay
dark. Parts of the target there have no weight. Limits are searched at 2·held + scaled_dual.
"""

from __future__ import annotations

import numpy as np

from vamgpu.kernels.reduce import CPU, Parts, disc
from vamgpu.kernels.reduce import GPU as PARTIAL
from vamgpu.kernels.signature import Array, ArrayInOut, ArrayOut, Real, Tiling, kernel

GPU = Tiling(major=1, minor=1)


def _counted(target: np.ndarray, reach: float, rim: float) -> np.ndarray:
    near = disc(target.shape[0], target.shape[1], reach)[:, :, None]
    return np.where(near, 1.0, np.where(target >= 0.5, 0.0, rim))


@kernel(over="held", cpu=CPU, gpu=PARTIAL)
def find_levels(
    held: Array, scaled_dual: Array, target: Array, least: Real, leak: Real, reach: Real, rim: Real, below: Parts,
    shorts: Parts, above: Parts, over: Parts,
) -> None:  # fmt: skip
    """Number of part voxels below the least dose and their total deficit; void voxels above the leak and their excess.

    Doses in the part are clipped to 1.
    """
    counted, dose = _counted(target, reach, rim), 2.0 * held + scaled_dual
    lacks = np.where(target >= 0.5, least - np.minimum(dose, 1.0), 0.0)
    leaks = np.where(target < 0.5, dose - leak, 0.0)
    for count, amount, values in ((below, shorts, lacks), (above, over, leaks)):
        count[...] = amount[...] = 0.0
        count[0], amount[0] = (counted * (values > 0.0)).sum(), (counted * np.maximum(values, 0.0)).sum()


@kernel(over="pull", cpu=CPU, gpu=GPU)
def clip_dose(
    held: Array, target: Array, least: Real, leak: Real, relax: Real, reach: Real, rim: Real, scaled_dual: ArrayInOut,
    pull: ArrayOut,
) -> None:  # fmt: skip
    """pull = the dose clipped to its limits, over-relaxed by ``relax``, minus the reflected dose.

    Limits are least to 1 inside, at most leak outside; scaled_dual is updated.
    """
    dose = 2.0 * held + scaled_dual
    within = np.where(target >= 0.5, np.maximum(np.minimum(dose, 1.0), least), np.minimum(dose, leak))
    beyond = relax * within + (1.0 - relax) * held
    pull[...] = _counted(target, reach, rim) * (beyond - dose)
    scaled_dual[...] = dose - held - beyond


@kernel(over="light", cpu=CPU, gpu=GPU)
def clip_light(
    light: Array, white: Array, push: Real, base: Real, relax: Real, scaled_dual: ArrayInOut, pull: ArrayInOut
) -> None:
    """pull += base·(the light clipped to 0…white, over-relaxed by ``relax``, minus the reflected light).

    Light is driven to both limits by push times its distance from their middle; scaled_dual is updated.
    """
    bright = 2.0 * light + scaled_dual
    driven = bright + push * (bright - 0.5 * white)
    beyond = relax * np.clip(driven, 0.0, white) + (1.0 - relax) * light
    pull[...] += base * (beyond - bright)
    scaled_dual[...] = bright - light - beyond

"""Steps towards the widest process window that let light, its dose, and the limits of both step apart.

Source: J. Eckstein, D. P. Bertsekas, Math. Program. 55 (1992) 293. A dose is held to its limits apart from the light
that makes it, and light to being 0 or more apart from both; what each still owes the other is carried on. Inside is a
target of at least one half. Farther than ``reach`` samples from the axis voids count ``rim`` of the others: nobody
judges them, but they are to stay dark. What is of the part there counts nothing.

``owed`` is what a point has still to make up for, less twice what it held: with what is held now, 2·held + owed is
where the limits are looked for.
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
def split_levels(
    held: Array, owed: Array, target: Array, least: Real, leak: Real, reach: Real, rim: Real, below: Parts,
    shorts: Parts, above: Parts, over: Parts,
) -> None:  # fmt: skip
    """How many voxels of the part are below a least dose, and how much they lack together; so above a leak outside.

    Doses of the part count as 1 at most.
    """
    counted, dose = _counted(target, reach, rim), 2.0 * held + owed
    lacks = np.where(target >= 0.5, least - np.minimum(dose, 1.0), 0.0)
    leaks = np.where(target < 0.5, dose - leak, 0.0)
    for count, amount, values in ((below, shorts, lacks), (above, over, leaks)):
        count[...] = amount[...] = 0.0
        count[0], amount[0] = (counted * (values > 0.0)).sum(), (counted * np.maximum(values, 0.0)).sum()


@kernel(over="pull", cpu=CPU, gpu=GPU)
def split_dose(
    held: Array, target: Array, least: Real, leak: Real, relax: Real, reach: Real, rim: Real, owed: ArrayInOut,
    pull: ArrayOut,
) -> None:  # fmt: skip
    """pull = the dose within its limits, gone beyond by ``relax``, less where it was looked for; owed is renewed.

    Limits are least to 1 inside, leak at most outside.
    """
    dose = 2.0 * held + owed
    within = np.where(target >= 0.5, np.maximum(np.minimum(dose, 1.0), least), np.minimum(dose, leak))
    beyond = relax * within + (1.0 - relax) * held
    pull[...] = _counted(target, reach, rim) * (beyond - dose)
    owed[...] = dose - held - beyond


@kernel(over="light", cpu=CPU, gpu=PARTIAL)
def split_light(
    light: Array, base: Real, relax: Real, most: Real, owed: ArrayInOut, pull: ArrayInOut, over: Parts
) -> None:
    """pull += base·(the light from 0 to most, gone beyond by ``relax``, less where it was looked for).

    owed is renewed, as of `split_dose`.  Σ over: by how much light was looked for above most.
    """
    bright = 2.0 * light + owed
    beyond = relax * np.clip(bright, 0.0, most) + (1.0 - relax) * light
    pull[...] += base * (beyond - bright)
    owed[...] = bright - light - beyond
    over[...] = 0.0
    over[0] = np.maximum(bright - most, 0.0).sum()


@kernel(over="light", cpu=CPU, gpu=GPU)
def split_two_levels(
    light: Array, white: Array, push: Real, base: Real, relax: Real, owed: ArrayInOut, pull: ArrayInOut
) -> None:
    """`split_light` from 0 to white, driven to these ends by push times the way from their middle."""
    bright = 2.0 * light + owed
    driven = bright + push * (bright - 0.5 * white)
    beyond = relax * np.clip(driven, 0.0, white) + (1.0 - relax) * light
    pull[...] += base * (beyond - bright)
    owed[...] = bright - light - beyond


@kernel(over="wall", cpu=CPU, gpu=GPU)
def split_prices(
    held: Array, owed: Array, target: Array, least: Real, leak: Real, reach: Real, rim: Real, wall: ArrayOut,
    cap: ArrayOut,
) -> None:  # fmt: skip
    """Prices of the limits of a dose: ``wall`` of too little inside and too much outside, ``cap`` above 1 inside."""
    counted, part, dose = _counted(target, reach, rim), target >= 0.5, 2.0 * held + owed
    wall[...] = counted * np.maximum(0.0, np.where(part, least - dose, dose - leak))
    cap[...] = counted * np.where(part, np.maximum(0.0, dose - 1.0), 0.0)

"""Pixels that change to another level if this brings the sum of all doses closer to a part's requirements."""

from __future__ import annotations

import numpy as np

from vamgpu.kernels.pointwise import CPU, pointwise
from vamgpu.kernels.signature import Array, ArrayInOut, ArrayOut, Integer, Real, kernel

SPREAD = 3518319155, 2882110345, 2360945575, 2654435769
"""Steps of 2³² that fill a cube evenly: negative powers of the root of g⁴ = g + 1 (M. Roberts' R3 sequence), and the
golden ratio from one round to the next."""


@pointwise(over="brighter")
def price_flips(
    dose: Array, side: Array, least: Real, most: Real, leak: Real, step: Real, brighter: ArrayOut, darker: ArrayOut
) -> None:
    """Change of a voxel's squared dose error, over ``step``, if its dose rises (brighter) or falls (darker) by that."""
    # side: above 0 in the part, whose dose must be from ``least`` to ``most``; below 0 in a void, whose dose must be at
    # most ``leak``; 0 if any dose is allowed. The sum of these along a pixel's light, weighted by its dose in each
    # voxel, is the change of the error if the pixel is flipped, assuming that every voxel that it lights gets the step.

    def off(given: np.ndarray) -> np.ndarray:
        part = np.maximum(least - given, 0.0) + np.maximum(given - most, 0.0)
        return np.where(side > 0, part, np.where(side < 0, np.maximum(given - leak, 0.0), 0.0)) ** 2

    brighter[...] = (off(dose + step) - off(dose)) / step
    darker[...] = (off(dose - step) - off(dose)) / step


@pointwise(over="change")
def flip_pixels(brighter: Array, darker: Array, step: Array, light: ArrayInOut, change: ArrayOut) -> None:
    """Flip each pixel if that lowers the error: lit ones (light > 0) with darker < 0, others with brighter < 0."""
    # step: a pixel's light if it is on, minus that if it is off; 0 for pixels that must not change.
    lit = light > 0
    change[...] = np.where(lit, np.where(darker < 0, -step, 0.0), np.where(brighter < 0, step, 0.0))
    light += change


@kernel(over="light", reach="first", cpu=CPU)
def step_pixels(
    brighter: Array, darker: Array, worth: Real, seed: Integer, first: Integer, step: Real, most: Real,
    light: ArrayInOut,
) -> None:  # fmt: skip
    """Change some of the pixels to light ± step, from 0 to most, if this lowers the error."""
    # worth: gain (minus the smaller of both error changes) above which all pixels change; others change with a
    # probability of their gain over it. seed: of the random choice. first: number of the first slice.
    gain = -np.minimum(brighter, darker)
    i, j, k = np.ogrid[tuple(slice(n) for n in light.shape)]
    place = sum(axis.astype(np.uint64) * factor for axis, factor in zip((i, j, k + first), SPREAD, strict=False))
    place = (place + np.uint64(seed) * np.uint64(SPREAD[3])) & np.uint64(0xFFFFFFFF)
    chosen = (place >> np.uint64(8)) / 2.0**24 * worth < gain
    stepped = light + np.where(brighter <= darker, step, -step)
    light[...] = np.where(chosen, np.clip(stepped, 0.0, most), light)

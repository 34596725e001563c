"""Pixels of two levels that are flipped where the dose of all of them comes nearer to what a part asks for."""

from __future__ import annotations

import numpy as np

from vamgpu.kernels.reduce import CPU
from vamgpu.kernels.signature import Array, ArrayInOut, ArrayOut, Real, Tiling, kernel

GPU = Tiling(major=1, minor=1)


@kernel(over="brighter", cpu=CPU, gpu=GPU)
def price_flips(
    dose: Array, side: Array, least: Real, most: Real, leak: Real, step: Real, brighter: ArrayOut, darker: ArrayOut
) -> None:
    """How much further off a voxel's dose is by ``step`` more or less light, squared, over the step.

    side: above 0 in the part, whose dose is to be from ``least`` to ``most``; below 0 in a void, which is to get
    ``leak`` at the most; 0 where any dose will do. A pixel's sum of these along its light, weighted by how much a voxel
    gets of it, is what flipping it changes, as if every voxel that it lights got the step.
    """

    def off(given: np.ndarray) -> np.ndarray:
        part = np.maximum(least - given, 0.0) + np.maximum(given - most, 0.0)
        return np.where(side > 0, part, np.where(side < 0, np.maximum(given - leak, 0.0), 0.0)) ** 2

    brighter[...] = (off(dose + step) - off(dose)) / step
    darker[...] = (off(dose - step) - off(dose)) / step


@kernel(over="change", cpu=CPU, gpu=GPU)
def flip_pixels(brighter: Array, darker: Array, step: Array, light: ArrayInOut, change: ArrayOut) -> None:
    """Flip each pixel that gains by it: lit ones (light > 0) with darker < 0, others with brighter < 0.

    step: light of a pixel that is on, more than off; 0 for pixels that stay. change: what is added to light.
    """
    lit = light > 0
    change[...] = np.where(lit, np.where(darker < 0, -step, 0.0), np.where(brighter < 0, step, 0.0))
    light += change

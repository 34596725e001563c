"""Light absorbed by a print, from a camera's images, and the images that a field would make."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from vamgpu.kernels.pointwise import CPU, pointwise
from vamgpu.kernels.signature import Integer, Real, Sinogram, SinogramInOut, SinogramOut, Table, kernel

Images = Annotated[np.ndarray, Table("float32", ("angle", "z", "r"))]
Open = Annotated[np.ndarray, Table("float32", ("shot", "z", "r"))]
"""Gray levels through the vial before the print, for one image or for every angle."""
Reached = Annotated[np.ndarray, Table("float32", ("r",))]
"""Share of a column's light that enters: operators multiply rays by it; 0 beyond the vial."""
Numbers = Annotated[np.ndarray, Table("int32", ("z",))]

FAINTEST = 2.0
"""Least brightness of a valid pixel, in standard deviations of its noise."""
FAINT = 1e-6
"""Least share of light whose logarithm is computed."""
SPREAD = np.uint32(2654435769)
"""Factors of seeds; near seeds then give different numbers."""


@kernel(over="depth", cpu=CPU)
def measure_depth(
    images: Images, open: Open, reached: Reached, floor: Real, gain: Real, brightest: Real, depth: SinogramOut,
    weight: SinogramOut,
) -> None:  # fmt: skip
    """depth = reached·ln(open / image), weight = 1 / its variance; both are 0 for invalid pixels."""
    # floor: variance of the dark noise. gain: variance per gray level. brightest: least saturated level.
    levels, field = images.swapaxes(1, 2), np.resize(open, (len(images), *open.shape[1:])).swapaxes(1, 2)
    variance, lit = floor + gain * np.maximum(levels, 0.0), reached[:, None] > 0.0
    good = (levels**2 > FAINTEST**2 * variance) & (levels < brightest) & (field > 0.0) & lit
    share = np.where(lit, reached[:, None], 1.0)
    depth[...] = np.where(good, share * np.log(np.where(good, field, 1.0) / np.where(good, levels, 1.0)), 0.0)
    weight[...] = np.where(good, levels**2 / (variance * share**2), 0.0)


@pointwise(over="dark")
def dim_light(path: Sinogram, reached: Reached, dark: SinogramOut) -> None:
    """dark = 1 − exp(−path / reached), the share of light that is lost; dark may be path."""
    lit = reached[:, None] > 0.0
    dark[...] = np.where(lit, 1.0 - np.exp(-path / np.where(lit, reached[:, None], 1.0)), 0.0)


@pointwise(over="depth")
def take_bias(dark: Sinogram, linear: Sinogram, reached: Reached, depth: SinogramInOut) -> None:
    """depth −= −reached·ln(1 − dark) − linear, the excess of depths in images over the sum along the rays."""
    lit = reached[:, None] > 0.0
    depth -= np.where(lit, -reached[:, None] * np.log(np.maximum(1.0 - dark, FAINT)) - linear, 0.0)


@kernel(over="noise", cpu=CPU)
def draw_noise(weight: Sinogram, slices: Numbers, seed: Integer, noise: SinogramOut) -> None:
    """Normally distributed noise of variance 1 / weight, 0 where weight is 0; the same on every device and layout."""
    # slices: 0, 1, 2, … Sources: M. E. O'Neill's hash PCG-RXS-M-XS-32; Box & Muller, Ann. Math. Stat. 29 (1958) 610.
    with np.errstate(over="ignore"):
        columns = np.arange(weight.shape[0] * weight.shape[1], dtype=np.uint32) + np.uint32(seed) * SPREAD
        first = hashed(hashed(columns)[:, None] + slices.astype(np.uint32))
        second = hashed(first)
    near, turn = (((each >> np.uint32(8)) + 0.5) / 2.0**24 for each in (first, second))
    normal = np.sqrt(-2.0 * np.log(near)) * np.cos(2.0 * np.pi * turn)
    known = np.where(weight > 0.0, weight, 1.0)
    noise[...] = np.where(weight > 0.0, normal.reshape(weight.shape) / np.sqrt(known), 0.0)


def hashed(number: np.ndarray) -> np.ndarray:
    """Each uint32 mapped to another one."""
    state = number * np.uint32(747796405) + np.uint32(2891336453)
    word = ((state >> ((state >> np.uint32(28)) + np.uint32(4))) ^ state) * np.uint32(277803737)
    return (word >> np.uint32(22)) ^ word

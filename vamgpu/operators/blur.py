"""Images blurred across columns and rows."""

from __future__ import annotations

from math import exp, log
from typing import final

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.kernels.blur import blur_slices
from vamgpu.kernels.filter import filter_rows
from vamgpu.operators.compose import NO_FLOOR
from vamgpu.operators.linear import LinearOperator
from vamgpu.operators.space import Space

FINE = 32  # samples per pixel of a profile whose width is measured


@final
class Blur(LinearOperator):
    """Images [angle, r, z] blurred along r and along z by symmetric taps, given for one side; self-adjoint."""

    range: Space

    def __init__(self, space: Space, device: Device, columns: np.ndarray, rows: np.ndarray) -> None:
        self.domain = self.range = space
        self.device = device
        self._columns, self._rows = device.table(columns), device.table(rows)

    def forward(self, x: DeviceArray, out: DeviceArray) -> None:
        half = self.device.empty(x.shape)
        self.device.launch(filter_rows, sinogram=x, taps=self._columns, stride=1, floor=NO_FLOOR, filtered=half)
        self.device.launch(blur_slices, source=half, taps=self._rows, blurred=out)

    def transposed(self, y: DeviceArray, out: DeviceArray) -> None:
        self.forward(y, out)


def gaussian(fwhm: float, width: float = 1.0) -> np.ndarray:
    """One side of Gaussian taps with sum one; for voxels ``width`` ≥ 1 pixels wide, a pixel is ``fwhm`` wide."""
    reach = np.arange(3 + int(2.6 * fwhm))
    low, high = log(1e-3), log(0.2 * fwhm**2 + 0.5)
    if width_of(_taps(low, reach), width) >= fwhm:
        return np.ones(1)
    for _ in range(50):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if width_of(_taps(middle, reach), width) < fwhm else (low, middle)
    return _taps(high, reach)


def _taps(log_variance: float, reach: np.ndarray) -> np.ndarray:
    values = np.exp(-0.5 * reach**2 / exp(log_variance))
    return values / (2.0 * values.sum() - values[0])


def width_of(taps: np.ndarray, width: float) -> float:
    """Full width at half maximum [pixels] of one pixel after the taps, as seen by voxels ``width`` pixels wide."""
    place = np.arange(FINE * (len(taps) + int(width) + 2)) / FINE
    pixels = np.arange(1 - len(taps), len(taps))
    overlap = np.clip(0.5 * (1.0 + width) - np.abs(place[:, None] - pixels), 0.0, 1.0) / width
    profile = overlap @ taps[np.abs(pixels)]
    below = int(np.argmax(profile <= 0.5 * profile[0]))
    over, under = profile[below - 1] - 0.5 * profile[0], 0.5 * profile[0] - profile[below]
    return 2.0 * float(place[below - 1] + over / (over + under) / FINE)

"""Dose of some voxels near given parameters of a print, to second order."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.live.prior import OPTICAL


@dataclass(frozen=True, eq=False)
class Fit:
    """Data of a fit: light, numbers of n voxels, their conversion and its deviation; mean, whitening."""

    light: DeviceArray
    used: np.ndarray
    seen: np.ndarray
    sigma: np.ndarray
    mean: np.ndarray
    whitening: np.ndarray


@dataclass(frozen=True, eq=False)
class LocalDose:
    """Dose of n voxels near some parameters, to second order in the optical ones."""

    center: np.ndarray  # parameters, (7,)
    even: np.ndarray  # dose at the center for a gain of 1, (n,)
    slopes: np.ndarray  # derivatives of it, (3, n)
    curves: np.ndarray  # second derivatives, (3, n)
    up: np.ndarray  # profile of the gain along z, (n,)
    out: np.ndarray  # profile along r, (n,)

    def _parts(self, p: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        off = (p - self.center)[list(OPTICAL)]
        even = self.even + off @ self.slopes + 0.5 * off**2 @ self.curves
        return even, self.slopes + off[:, None] * self.curves, 1.0 + p[4] * self.up + p[5] * self.out

    def dose(self, p: np.ndarray) -> np.ndarray:
        """Dose of the voxels, (n,)."""
        even, _, profile = self._parts(p)
        return p[6] + p[0] * profile * even

    def rates(self, p: np.ndarray) -> np.ndarray:
        """Derivatives of the dose by the parameters, (7, n)."""
        even, slopes, profile = self._parts(p)
        gains = profile * even, *(p[0] * profile * slopes), p[0] * even * self.up, p[0] * even * self.out
        return np.stack([*gains, np.ones_like(even)])

"""Turbidity, from how much the images of a print darken from turn to turn."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from vamgpu.backend.array import DeviceArray
from vamgpu.live.camera import LEAST
from vamgpu.live.fields import picked, places
from vamgpu.live.prior import Prior
from vamgpu.live.tomography import TINY, Tomograph
from vamgpu.live.trust import some

VOXELS = 4000  # greatest number of voxels whose dose is kept
LIT = 0.5  # share of the greatest planned dose below which voxels cure too late to count
MODEL, DRIFT = 0.02, 0.01  # errors of a darkening: a share of the greatest one, and a share of the planned print's
BOUNDS = (-3.0, -np.inf, 0.2), (3.0, np.inf, 5.0)
"""Bounds of the logarithm of the gain, of the initial dose, and of the factor."""
STARTS = np.linspace(-2.0, 3.0, 21)  # initial doses to start from, in deviations from the usual one

Darkness = tuple[float, np.ndarray]


class Darkening:
    """How dark voxels of some doses make the images, as a share of the planned print's darkness."""

    depth: np.ndarray
    """Mean optical depth of that image, [row, column]."""

    def __init__(self, tomograph: Tomograph, conversion: Callable[[Any], np.ndarray], dose: DeviceArray) -> None:
        # darkness: sum of optical depths, weighted by the planned print's less their mean: the camera's gain cancels
        A, camera, planned = tomograph.operator, tomograph.camera, dose.numpy()
        self._resin, self._conversion = tomograph.turbidity, conversion
        cured = self._resin.extinction_at(conversion(planned)).astype(np.float32)
        passed = 1.0 - some(camera.darkened(cured).numpy())
        self.depth = -np.log(np.maximum(passed, TINY)).mean(axis=0).T
        seen = (camera.reached.T > LEAST) & (np.broadcast_to(camera.open_field, camera.shape)[0] > 0.0)
        weight = np.where(seen, self.depth - self.depth.mean(where=seen), 0.0)
        self._pixels = weight / max((weight * self.depth).sum(), TINY)
        even = self._pixels.T / np.maximum(camera.reached, LEAST)
        lit = np.flatnonzero(planned >= LIT * planned.max())
        voxels = np.sort(np.random.default_rng(0).choice(lit, min(VOXELS, lit.size), replace=False))
        self._places = places(A.device, voxels, planned.shape)
        back = A.T(A.device.field(np.broadcast_to(even, A.range.shape).astype(np.float32)))
        self._share = picked(back, self._places)
        self._share /= max(self._made(picked(dose, self._places)), TINY)

    def _made(self, dose: np.ndarray) -> np.ndarray:
        """Darkness by doses of the voxels, (turns, voxels)."""
        return self._resin.extinction_at(self._conversion(dose)) @ self._share

    def seen(self, level: np.ndarray, dose: DeviceArray) -> Darkness:
        """Darkness of the images of a turn, from their mean logarithm [row, column], and planned dose of the voxels."""
        return -float((self._pixels * level).sum()), picked(dose, self._places)

    def turbidity(self, seen: Sequence[Darkness], prior: Prior) -> tuple[float, float]:
        """Extinction of successive turns over the assumed one, and its deviation: most probable with gain and dose."""
        error = self._resin.error
        if not error:
            return 1.0, 0.0
        dark, doses = np.array([each for each, _ in seen]), np.stack([dose for _, dose in seen])
        change, gain, initial = dark - dark[0], *prior.mean[[0, 6]]
        usual = np.sqrt([prior.covariance[0, 0] / gain**2, prior.covariance[6, 6], error**2])
        mean, scale = np.array([np.log(gain), initial, 1.0]), np.hypot(MODEL * change.max(), DRIFT)

        def gaps(p: np.ndarray, scale: float) -> np.ndarray:
            made = p[2] * self._made(np.exp(p[0]) * doses + p[1])
            return np.concatenate([(made - made[0] - change)[1:] / scale, (p - mean) / usual])

        tried = mean + STARTS[:, None] * usual * (0.0, 1.0, 0.0)  # without curing, every slope is 0
        start = min(tried, key=lambda p: float(np.square(gaps(p, scale)).sum()))
        found: Any = None
        for _ in range(2):  # the second fit uses the errors that remain after the first
            found = least_squares(gaps, start, bounds=BOUNDS, args=(scale,))
            scale *= max(float(np.sqrt(np.mean(np.square(found.fun[:-3])))), 1.0) if len(seen) > 1 else 1.0
        return float(found.x[2]), float(np.sqrt(np.linalg.inv(found.jac.T @ found.jac)[2, 2]))

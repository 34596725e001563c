"""The best dose that a limited range of angles can give in a plane of film, for comparing index ratios."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.geometry import Beam, Grid, Turntable, centers, counts, positive
from vamgpu.metrics.pointspread import steepest
from vamgpu.operators.projection import Projection

Array = npt.NDArray[np.float64]

IN_BAND, OUT_BAND = 0.01, 0.05
"""Deviations from 1 in the part, and above 0 outside, that cause no loss: the bands of the roll-to-roll paper."""
STEEPNESS, MIDDLE = 10.0, 0.5


def random_plane(n: int, seed: int = 1, filled: float = 0.45) -> Array:
    """A disk (n, n) of random structure with many sizes and all directions, 0 or 1: filtered noise above a quantile."""
    # filled: share of 1 in it.
    size = counts("n", (n,), 1)[0]
    if not 0.0 < filled < 1.0 or size < 16:
        raise BadInput(f"got n = {n} and filled = {filled!r}; expected at least 16 voxels and a share between 0 and 1")
    k = np.fft.fftfreq(size) * size
    band = np.exp(-0.5 * ((np.hypot(k[:, None], k[None, :]) - size / 12) / (size / 20)) ** 2)
    noise = np.random.default_rng(seed).normal(size=(size, size))
    smooth = np.fft.ifft2(np.fft.fft2(noise) * band).real
    x = centers(size, 1.0)
    disk = np.hypot(x[:, None], x[None, :]) < 0.46 * size
    return ((smooth > np.quantile(smooth, 1.0 - filled)) & disk).astype(np.float64)


def limited_dose(
    target: npt.ArrayLike, pitch: float, ratio: float, *, angles: int = 240, iterations: int = 60,
    device: str | Device | None = None,
) -> Array:  # fmt: skip
    """Dose [l, rho] of light ≥ 0 from within arcsin m of the film's normal ρ, fit to a target [l, rho] of 0 and 1."""
    # Straight rays without absorption; only the range of angles differs. Accelerated projected gradients reduce the
    # squares of deviations beyond the bands about 1 and 0, starting from the clipped projections. pitch: voxel edge
    # [mm]. ratio: m = n_medium/n_resin. angles: how many over a full turn.
    part = np.asarray(target, np.float64)
    if part.ndim != 2 or part.shape[0] != part.shape[1] or not np.isin(part, (0.0, 1.0)).all() or not part.any():
        raise BadInput(f"the target has shape {part.shape}; expected a square [l, rho] of 0 and 1, not all 0")
    light = _LimitedAngles(part.shape[0], positive("pitch [mm]", pitch), steepest(ratio), angles, device)
    norm = light.norm()
    sent = np.maximum(light.forward(part), 0.0)
    dose = light.back(sent)
    sent *= float((dose * part).sum() / (dose * dose).sum())
    ahead, weight = sent, 1.0
    for _ in range(counts("iterations", (iterations,), 1)[0]):
        dose = light.back(ahead)
        low, high = np.where(part > 0, 1.0 - IN_BAND, 0.0), np.where(part > 0, 1.0 + IN_BAND, OUT_BAND)
        excess = np.minimum(dose - low, 0.0) + np.maximum(dose - high, 0.0)
        step = np.maximum(ahead - light.forward(excess) / norm, 0.0)
        following = 0.5 * (1.0 + np.sqrt(1.0 + 4.0 * weight**2))
        ahead, sent, weight = step + (weight - 1.0) / following * (step - sent), step, following
    return light.back(sent)


def responded(dose: npt.ArrayLike) -> Array:
    """A logistic response to a dose, steepness 10 about the dose 0.5: M(f) of eq. S12."""
    return 1.0 / (1.0 + np.exp(-STEEPNESS * (np.asarray(dose, np.float64) - MIDDLE)))


class _LimitedAngles:
    """Projection of a plane [l, rho] within a range of angles about ρ, which is along the grid's x."""

    def __init__(self, n: int, pitch: float, limit: float, angles: int, device: str | Device | None) -> None:
        self._n = n
        motion = Turntable(angles, lit_share=0)
        self._operator = Projection(Grid((n, n, 1), pitch), Beam((n, 1), pitch), motion, device=device)
        off = np.abs((self._operator.motion.poses + 0.5 * np.pi) % np.pi - 0.5 * np.pi)
        self._lit = (off <= limit * (1.0 + 1e-12)).astype(np.float64)[:, None, None]

    def forward(self, plane: Array) -> Array:
        volume = np.ascontiguousarray(plane.T[..., None], np.float32)
        return self._operator(self._operator.device.upload(volume)).numpy().astype(np.float64) * self._lit

    def back(self, light: Array) -> Array:
        sent = np.ascontiguousarray(light * self._lit, np.float32)
        return self._operator.T(self._operator.device.upload(sent)).numpy()[..., 0].T.astype(np.float64)

    def norm(self) -> float:
        """The greatest eigenvalue of back ∘ forward, from power iteration (a lower bound), with a small margin."""
        plane, value = np.ones((self._n, self._n)), 1.0
        for _ in range(8):
            plane = self.back(self.forward(plane))
            value = float(np.linalg.norm(plane))
            plane /= value
        return 1.02 * value

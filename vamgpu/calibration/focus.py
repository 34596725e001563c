"""Focus of a tunable lens, from pictures of a grating by a camera on a stage: sharpness, its peak, the line of peaks.

Source: J. Toombs et al., "Roll-to-roll tomographic volumetric additive manufacturing", section S5.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from vamgpu.calibration.fits import check_finite, fitted
from vamgpu.errors import BadInput

LEAST_POWERS = 6  # least number of readings for a peak, which has four parameters; fewer do not show how well it fits

ROUNDS = 4  # number of fits of a peak, each around the middle found by the previous one

HARMONICS = np.arange(1.0, 16.0, 2.0) ** 2  # squares of the odd harmonics of a Ronchi grating that a camera may see

RATIO = 0.1  # initial ratios of blur to period for fits of a grating

FAINT = 1e-6  # least weight of a reading that counts

REACH = 3.0
"""Range around a peak, in its widths, from which its position is found, if the powers extend that far on both sides."""

LEAST_SHARE = 0.6  # share of the variance of sharpness that a peak must explain; noise alone gives 0.1 to 0.5


@dataclass(frozen=True)
class Peak:
    """A Lorentzian floor + height / (1 + ((p − power) / width)²) fitted to sharpness over lens power."""

    power: float  # of the sharpest picture [dpt]
    width: float  # half width at half height [dpt]
    height: float
    floor: float
    error: float  # standard error of the power [dpt], from noise and the misfit of the curve
    scatter: float  # standard deviation of the readings about the curve

    def __call__(self, power: ArrayLike) -> np.ndarray:
        """Sharpness at powers [dpt]; same shape."""
        return lorentzian(np.asarray(power, np.float64), self.power, self.width, self.height, self.floor)


@dataclass(frozen=True)
class FocusLine:
    """Focus against lens power: position = slope·power + intercept."""

    slope: float  # [mm/dpt]
    intercept: float  # position [mm] of the focus at a power of 0
    error: float  # standard error of the slope [mm/dpt]
    positions: tuple[float, ...]  # of the camera [mm]
    peaks: tuple[Peak, ...]  # one for every position

    def power(self, position: ArrayLike) -> np.ndarray:
        """Powers [dpt] that focus at positions [mm] of the camera's stage; same shape."""
        return (np.asarray(position, np.float64) - self.intercept) / self.slope


def tenengrad(pictures: ArrayLike) -> np.ndarray:
    """Mean squared Sobel gradient of pictures [..., row, column]; shape [...], float64. Raises `BadInput`."""
    # S. Pertuz et al., Pattern Recognition 46 (2013) 1415
    given = np.asarray(pictures)
    if given.ndim < 2 or min(given.shape[-2:]) < 3:
        raise BadInput(f"the pictures have shape {given.shape}; expected [..., row, column] of 3 × 3 pixels at least")
    light = given.astype(np.float64)
    check_finite("pictures", light)
    up = light[..., :-2, :] + 2.0 * light[..., 1:-1, :] + light[..., 2:, :]
    side = light[..., :-2] + 2.0 * light[..., 1:-1] + light[..., 2:]
    across, along = up[..., 2:] - up[..., :-2], side[..., 2:, :] - side[..., :-2, :]
    return (across**2 + along**2).mean(axis=(-2, -1))


def lorentzian(x: np.ndarray, center: float, width: float, height: float, floor: float) -> np.ndarray:
    """floor + height / (1 + ((x − center) / width)²); shape of x."""
    return floor + height / (1.0 + ((x - center) / width) ** 2)


def fit_peak(powers: ArrayLike, sharpness: ArrayLike) -> Peak:
    """Lorentzian that best fits sharpness over lens powers [dpt], both (powers,). Raises `BadInput` without a peak."""
    power, sharp = _readings(powers, sharpness)
    span, floor, top = float(np.ptp(power)), float(np.quantile(sharp, 0.1)), int(np.argmax(sharp))
    height = float(sharp[top]) - floor
    if height <= 0:
        raise BadInput(
            f"all pictures of the stack are equally sharp, {floor:.4g}; expected a grating in focus at some power"
        )
    wide = power[sharp > floor + 0.5 * height]
    start = (power[top], max(0.5 * float(np.ptp(wide)), 0.5 * span / power.size), 1.0, 0.0)
    refusal = f"no peak fits {power.size} readings"
    found, _ = fitted(lorentzian, power, (sharp - floor) / height, start, refusal, "widen or refine the powers")
    center, width, scaled, base = (float(value) for value in found)
    left = sharp - lorentzian(power, center, width, height * scaled, floor + height * base)
    scatter = float(np.sqrt(left @ left / max(power.size - 4, 1)))
    _judge(power, center, 1.0 - float(left @ left) / float(np.sum((sharp - sharp.mean()) ** 2)))
    center, error = _centered(power, (sharp - floor) / height, found)
    return Peak(center, abs(width), height * scaled, floor + height * base, error, scatter)


def _centered(power: np.ndarray, sharp: np.ndarray, start: np.ndarray) -> tuple[float, float]:
    """The middle of a peak and its standard error [dpt], from a range of powers that is symmetric about it."""
    # Real peaks are not Lorentzians: if powers extend farther on one side, the wings there would shift the middle.
    from scipy.optimize import curve_fit

    low, high = float(power.min()), float(power.max())
    found, error = np.append(start, RATIO), np.inf
    for _ in range(ROUNDS):
        center, width = float(found[0]), abs(float(found[1]))
        reach = min(center - low, high - center, REACH * abs(float(start[1])))
        weight = np.clip(1.0 - ((power - center) / reach) ** 2, 0.0, None) ** 2
        near = weight > FAINT
        if width == 0.0 or np.count_nonzero(near) <= found.size:
            break
        try:
            found, covariance = curve_fit(
                grating_sharpness, power[near], sharp[near], p0=found, sigma=weight[near] ** -0.5, maxfev=2000
            )
        except RuntimeError:  # keep the first fit
            break
        if not low < found[0] < high:
            break
        error = float(np.sqrt(covariance[0, 0]))
    if np.isfinite(error) and low < found[0] < high:
        return float(found[0]), error
    _, covariance = curve_fit(lorentzian, power, sharp, p0=start, maxfev=4000)
    return float(start[0]), float(np.sqrt(covariance[0, 0]))


def grating_sharpness(
    x: np.ndarray, center: float, width: float, height: float, floor: float, ratio: float
) -> np.ndarray:
    """Mean squared gradient of a Ronchi grating blurred by a Gaussian, over lens power; shape of x."""
    # Odd harmonics k have equal gradients; their squares are reduced to exp(−(2πks/p)²), ratio = (2πs₀/p)², s ∝ 1 + u².
    blur = abs(ratio) * (1.0 + ((x - center) / width) ** 2)
    return floor + height * np.exp(-np.multiply.outer(blur, HARMONICS)).sum(axis=-1)


def focus_line(positions: ArrayLike, peaks: Sequence[Peak]) -> FocusLine:
    """The line through peaks at positions of the camera [mm]. Raises `BadInput` if the peaks do not move."""
    # Powers are uncertain, positions are not: powers are fitted over positions and the line is inverted.
    place = np.asarray(positions, np.float64)
    if place.shape != (len(peaks),) or not np.isfinite(place).all() or np.unique(place).size < 2:
        raise BadInput(f"positions is {positions!r}; expected two or more different ones [mm], one for each peak")
    power = np.array([peak.power for peak in peaks])
    error = np.array([peak.error for peak in peaks])
    weight = 1.0 / np.maximum(error, max(1e-3 * float(error.max()), 1e-12)) ** 2
    weight /= weight.sum()
    center, middle = float(weight @ place), float(weight @ power)
    spread = float(weight @ (place - center) ** 2)
    rise = float(weight @ ((place - center) * (power - middle))) / spread
    if rise == 0:
        raise BadInput(f"the sharpest power is {middle:.4g} dpt at every position; expected one that changes with it")
    off = power - middle - rise * (place - center)
    seen = float(weight @ off**2) / max(place.size - 2, 1)  # too few positions underestimate the scatter
    deviation = np.sqrt(max(seen, 1.0 / float((1.0 / error**2).sum()) if (error > 0).all() else 0.0) / spread)
    slope = 1.0 / rise
    return FocusLine(slope, center - slope * middle, float(deviation) * slope**2, tuple(place.tolist()), tuple(peaks))


def _readings(powers: ArrayLike, sharpness: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    power, sharp = np.asarray(powers, np.float64), np.asarray(sharpness, np.float64)
    if power.shape != sharp.shape or power.ndim != 1:
        raise BadInput(f"there are powers of shape {power.shape} and sharpness of {sharp.shape}; expected one for each")
    if np.unique(power).size < LEAST_POWERS:
        raise BadInput(f"the lens took {np.unique(power).size} powers; expected {LEAST_POWERS} or more to fit a peak")
    check_finite("powers or sharpness", power, sharp)
    return power, sharp


def _judge(power: np.ndarray, center: float, share: float) -> None:
    low, high = float(power.min()), float(power.max())
    if not low < center < high:
        raise BadInput(
            f"the pictures grow sharper up to an end: the peak would be at {center:.4g} dpt, outside the powers "
            f"{low:.4g} to {high:.4g} dpt; widen them"
        )
    if not share >= LEAST_SHARE:
        raise BadInput(
            f"a peak explains {100 * share:.0f} % of how sharpness varies; expected {100 * LEAST_SHARE:.0f} % or more: "
            "show a grating, expose longer"
        )

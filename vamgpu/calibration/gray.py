"""Light of gray levels, from readings of a photodiode or of a camera's mean."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from vamgpu.calibration.fits import check_finite
from vamgpu.errors import BadInput, ShapeMismatch

TOP = 255
LEAST_CONTRAST = 20.0  # least light of level 255, relative to the noise of a level's mean
STUCK = 0.05
"""Rise over the last levels, relative to that of the whole curve, below which the meter counts as saturated."""
FALLS = 6.0  # standard errors by which a level may lie below a lower level and still count as noise


@dataclass(frozen=True)
class GrayReading:
    """Light over gray levels, with the dark reading subtracted, never falling."""

    levels: tuple[int, ...]  # rising from 0 to 255
    intensity: tuple[float, ...]  # at each, in the readings' unit
    error: tuple[float, ...]  # standard error of each, including that of the dark reading
    moved: float  # the largest change of a level that makes the curve never fall

    @property
    def black(self) -> float:
        """Light of level 0 relative to that of level 255."""
        return self.intensity[0] / self.intensity[-1]


def fit_gray(levels: Sequence[int], readings: ArrayLike, dark: ArrayLike) -> GrayReading:
    """The curve that fits readings (levels, repeats) best and never falls. Raises `BadInput`, `ShapeMismatch`."""
    level, read, base = np.asarray(levels), np.asarray(readings, np.float64), np.asarray(dark, np.float64)
    if read.ndim != 2 or level.shape != read.shape[:1] or read.shape[1] < 2 or base.ndim != 1 or not base.size:
        raise ShapeMismatch(
            f"there are levels of shape {level.shape}, readings {read.shape} and dark ones {base.shape}; "
            "expected (levels,), (levels, 2 or more) and (1 or more,)"
        )
    check_finite("readings", read, base)
    if (np.diff(level) <= 0).any() or (int(level[0]), int(level[-1])) != (0, TOP) or (level != np.round(level)).any():
        raise BadInput(f"the levels go from {level[0]} to {level[-1]}; expected whole numbers rising from 0 to {TOP}")
    from scipy.optimize import isotonic_regression

    light = read.mean(axis=1) - base.mean()
    own = read.std(axis=1, ddof=1)  # at least that of a typical level, as few repeats estimate it badly
    typical, least = float(np.sqrt((own**2).mean())), 1e-9 * max(float(np.abs(read).max()), 1e-300)
    error = np.maximum(np.maximum(own, typical), least) / np.sqrt(read.shape[1])
    _judge(level, light, error)
    risen = isotonic_regression(light, weights=1.0 / error**2).x
    fall = risen - light
    if (np.abs(fall) > FALLS * error + 1e-9 * light[-1]).any():
        at = int(np.argmax(np.abs(fall) / error))
        raise BadInput(
            f"the light falls at level {level[at]} by {2 * abs(fall[at]):.3g}, {2 * abs(fall[at]) / error[at]:.0f} "
            "times the readings' error; expected light that never falls: let the lamp warm up, wait longer at each "
            "level"
        )
    kept = np.clip(risen, 0.0, None)
    whole = np.hypot(error, float(np.sqrt((error**2).mean() * read.shape[1] / base.size)))  # with the dark reading
    return GrayReading(tuple(int(each) for each in level), tuple(kept.tolist()), tuple(whole.tolist()),
                       float(np.abs(fall).max()))  # fmt: skip


def _judge(level: np.ndarray, light: np.ndarray, error: np.ndarray) -> None:
    rise = float(light[-1] - light[0])
    if not rise > LEAST_CONTRAST * float(error.max()):
        raise BadInput(
            f"the light rises by {rise:.4g} from level 0 to {TOP}, with an error of {float(error.max()):.2g}; expected "
            f"{LEAST_CONTRAST:g} times the error: light the meter, raise the power, average readings"
        )
    if light.size >= 4:
        last = float(light[-1] - light[-3]) / float(level[-1] - level[-3])
        if last < STUCK * rise / TOP:
            raise BadInput(
                f"the light no longer rises from level {level[-3]} to {TOP}; the meter is saturated, or the projector "
                "clips: lower the power or the range"
            )

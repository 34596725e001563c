"""Whether a turn's images agree with the light shown, and how much resin the planned light has cured."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from vamgpu.live.estimate import Estimate
    from vamgpu.live.tomography import Reconstruction

CLEAREST = 0.05
"""Quantile of the pixels that are assumed to show no cured resin."""
VISIBLE = 0.05
"""Least greatest optical depth from which a shift is looked for."""
SOME = 32
"""Least number of angles whose images are looked at for that."""
FAINT = 0.05
"""Share of the greatest darkening below which pixels are not compared."""


@dataclass(frozen=True)
class Trust:
    """Limits beyond which images do not decide the light.

    Simulated prints of 16 turns stay below 8, 0.04 and 0.24 with lamps of 60 to 125 %, errors of a fifth in turbidity
    and of a tenth in the gel point, and 60 % of the frames lost. A camera that is mirrored, upside down, rolled by 4°,
    late by three angles, wrong by a tenth in its gain, or behind a bubble exceeds one of them.

    Args:
        misfit: Greatest `Reconstruction.misfit`, if more than the share ``images`` is also unexplained.
        images: Unexplained share of the mean square of optical depths, dimensionless.
        conversion: Greatest `Estimate.unexplained`.
        sinking: Greatest shift of what is cured along the axis [pixels]. Simulated prints at rest stay below 0.15, and
            one that sinks by 0.15 of a pixel a turn reaches 0.3 two turns after it is seen.
    """

    misfit: float = 15.0
    images: float = 0.05
    conversion: float = 0.35
    sinking: float = 0.25

    def limit(self, seen: Reconstruction) -> float:
        """Greatest misfit of a reconstruction."""
        return max(self.misfit, self.images * seen.contrast)

    def of_images(self, seen: Reconstruction) -> str:
        """Reason not to trust a reconstruction; empty if there is none."""
        if seen.misfit <= self.limit(seen):
            return ""
        return (f"images differ from any field by {seen.misfit:.3g} times their noise (at most {self.limit(seen):.3g} "
                "expected): check open field, noise, orientation and place of the camera")  # fmt: skip

    def of_estimate(self, found: Estimate) -> str:
        """Reason not to trust an estimate; empty if there is none."""
        if found.unexplained <= self.conversion:
            return ""
        return (f"the light shown does not explain {100.0 * found.unexplained:.0f} % of the conversion seen (at most "
                f"{100.0 * self.conversion:g} % expected): check the camera's orientation and the resin")  # fmt: skip

    def of_place(self, sunk: float) -> str:
        """Why not to go on, from a shift of what is cured since it was first seen [pixels]; empty without a reason."""
        if abs(sunk) <= self.sinking:
            return ""
        return (f"what is cured has {'sunk' if sunk > 0.0 else 'risen'} by {abs(sunk):.2g} pixels (at most "
                f"{self.sinking:g} expected): check the viscosity of the resin, and what holds the part")  # fmt: skip


def sunk(last: np.ndarray, now: np.ndarray) -> float:
    """Shift towards lower rows of what darkens two images, by their optical depths [row, column]; 0 while it is faint.

    What is cured grows meanwhile, by a square of its depth that changes with height, and by the same everywhere.
    """
    mean = 0.5 * (last + now)
    if last.max() < VISIBLE or len(mean) < 3:
        return 0.0
    up, rise = np.linspace(-1.0, 1.0, len(mean))[:, None], np.gradient(mean, axis=0)
    growth = (np.ones_like(mean), mean, up * mean, mean**2, up * mean**2)
    terms = np.stack([each[1:-1].ravel() for each in (rise, *growth)], axis=1)
    (shift, *_), *_ = np.linalg.lstsq(terms, (now - last)[1:-1].ravel(), rcond=None)
    return float(shift)


def some(frames: np.ndarray) -> np.ndarray:
    """Images of evenly spaced angles, [angle, row, column]: enough for means, and to find repeated ones."""
    values = np.asarray(frames)
    return values[:: max(len(values) // SOME, 1)]


def digest(frames: np.ndarray) -> str:
    """Digest of images or patterns; empty if no number is finite, for example if no image arrived."""
    values = np.asarray(frames)
    if values.dtype.kind not in "fiu" or not np.isfinite(values).any():
        return ""
    return hashlib.sha256(np.ascontiguousarray(values).tobytes()).hexdigest()


def mean_level(frames: np.ndarray, shape: tuple[int, ...]) -> np.ndarray | None:
    """Mean logarithm of gray levels [angle, row, column] over the angles that arrived, [row, column], or None."""
    values = np.asarray(frames)
    if values.shape != shape or values.dtype.kind not in "fiu":
        return None  # the analysis of the images reports what is wrong with them
    arrived = [frame for frame in some(values) if np.isfinite(frame).all()]  # one after another: no copy of all of them
    total = sum((np.log(np.maximum(frame, 1.0)) for frame in arrived), np.zeros(shape[1:]))
    return total / len(arrived) if arrived else None


def darkening(change: np.ndarray) -> np.ndarray:
    """Optical depths of pixels minus that of the clearest, sorted; a camera's gain and orientation cancel."""
    return np.sort((change - np.quantile(change, CLEAREST)).ravel())


def share_of(seen: np.ndarray, expected: np.ndarray) -> float:
    """Share of the expected darkening that is seen: the weighted median over pixels, which ignores dust; or NaN."""
    counted = expected > FAINT * expected[-1]
    if seen.shape != expected.shape or not counted.any():
        return float("nan")
    ratio, weight = seen[counted] / expected[counted], expected[counted]
    order = np.argsort(ratio)
    half = np.searchsorted(weight[order].cumsum(), 0.5 * weight.sum())
    return float(ratio[order][min(half, ratio.size - 1)])

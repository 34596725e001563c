"""Whether a turn's images agree with the light shown, and how much resin the planned light has cured."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from vamgpu.live.estimate import Estimate
    from vamgpu.live.tomography import Reconstruction

CLEAREST = 0.05  # quantile of the pixels that are assumed to show no cured resin
SOME = 32  # least number of angles used for that
FAINT = 0.05  # share of the greatest darkening below which pixels are not compared


@dataclass(frozen=True)
class Trust:
    """Limits beyond which the images are not used.

    Simulated prints of 16 turns stay below 8, 0.04 and 0.24 with lamps of 60 to 125 %, errors of a fifth in turbidity
    and of a tenth in the gel point, and 60 % of the frames lost. A camera that is mirrored, upside down, rolled by 4°,
    late by three angles, wrong by a tenth in its gain, or behind a bubble exceeds one of them.

    Args:
        misfit: Greatest `Reconstruction.misfit`, if more than the share ``images`` is also unexplained.
        images: Unexplained share of the mean square of optical depths, dimensionless.
        conversion: Greatest `Estimate.unexplained`.
    """

    misfit: float = 15.0
    images: float = 0.05
    conversion: float = 0.35

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

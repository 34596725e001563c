"""Dose inside a feature, bounded by the constraint curves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import isfinite

import numpy as np

from vamgpu.errors import BadInput

Profile = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""(mm from the back side, mm to the front) → Ω, for arrays of one shape; may be infinite."""


@dataclass(frozen=True)
class Flat:
    """The same dose everywhere.

    Args:
        most: Ω_max, a dose in critical doses; infinite for the greatest possible dose.

    Raises:
        BadInput: Ω_max is below 1.
    """

    most: float = float("inf")

    def __post_init__(self) -> None:
        if not self.most >= 1.0:
            raise BadInput(f"Ω_max is {self.most!r}; expected at least 1, the critical dose")

    def __call__(self, back: np.ndarray, front: np.ndarray) -> np.ndarray:
        return np.full(np.broadcast_shapes(back.shape, front.shape), self.most)


@dataclass(frozen=True)
class Parallel:
    """A dose between the critical dose and the nearer constraint curve.

    Args:
        share: Position between them, a share, 0 to 1.
        absorption_height: h_a [mm].
        least: Φ of level 0, a dose in critical doses.
        most: Φ of level 255, a dose in critical doses.

    Raises:
        BadInput: The share is out of range.
    """

    share: float
    absorption_height: float
    least: float
    most: float

    def __post_init__(self) -> None:
        if not (isfinite(self.share) and 0.0 <= self.share <= 1.0):
            raise BadInput(f"the share is {self.share!r}; expected a number from 0 to 1")

    def __call__(self, back: np.ndarray, front: np.ndarray) -> np.ndarray:
        built = (self.most - 1.0) * (1.0 - 10.0 ** (-back / self.absorption_height))
        left = (1.0 - self.least) * (10.0 ** np.minimum(front / self.absorption_height, 30.0) - 1.0)
        return 1.0 + self.share * np.minimum(built, left)

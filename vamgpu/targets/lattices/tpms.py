"""Solids bounded by triply periodic minimal surfaces, k = 2π/cell (Toombs et al., roll-to-roll printing, table S4).

Values are f / |∇f|: the distance [mm] to first order near the surface; far away, only the sign is right.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from math import isfinite, pi, sqrt

import numpy as np
import numpy.typing as npt

from vamgpu.errors import BadInput
from vamgpu.geometry import positive

Array = npt.NDArray[np.float64]
Sampled = tuple[Array, Array]

STEEPEST = sqrt(3.0)  # the partial derivatives of all functions here are at most 1; no function rises faster than this
_FLATTEST = 0.05  # lower limit of the gradient by phase, at maxima and saddles of a function
GYROID_PINCH = sqrt(2.0)
DIAMOND_PINCH = sqrt(0.5)


@dataclass(frozen=True)
class _Periodic(ABC):
    """A level set of a function of the three phases 2π·position/cell."""

    cell: float = 3.0

    def __call__(self, x: Array, y: Array, z: Array) -> Array:
        value, slope = self._sampled(*self._phases(x, y, z), slopes=True)
        return value / np.maximum(slope, _FLATTEST) / self._scale

    def bound(self, x: Array, y: Array, z: Array) -> Array:
        """At most the distance [mm] to the surface, negative inside."""
        return self._sampled(*self._phases(x, y, z), slopes=False)[0] / (STEEPEST * self._scale)

    @abstractmethod
    def _sampled(self, x: Array, y: Array, z: Array, *, slopes: bool) -> Sampled:
        """The function at phases, and the norm of its gradient (its own value if slopes are not needed)."""

    @property
    def _scale(self) -> float:
        return 2.0 * pi / self.cell

    def _phases(self, x: Array, y: Array, z: Array) -> tuple[Array, Array, Array]:
        return self._scale * np.asarray(x), self._scale * np.asarray(y), self._scale * np.asarray(z)


def _checked(shape: _Periodic, level: float, low: float, high: float, why: str) -> None:
    positive(f"{type(shape).__name__} cell [mm]", shape.cell)
    if not (isinstance(level, (int, float)) and isfinite(level) and low < level < high):
        raise BadInput(
            f"{type(shape).__name__} level is {level!r}; expected above {low:.4g} and below {high:.4g}: {why}"
        )


def _gyroid(x: Array, y: Array, z: Array, slopes: bool) -> Sampled:
    """sin ρ cos l + sin l cos z + sin z cos ρ at phases (l, ρ, z), and the norm of its gradient."""
    (sl, sr, sz), (cl, cr, cz) = (np.sin(x), np.sin(y), np.sin(z)), (np.cos(x), np.cos(y), np.cos(z))
    value = sr * cl + sl * cz + sz * cr
    if not slopes:
        return value, value
    return value, np.sqrt((cl * cz - sr * sl) ** 2 + (cr * cl - sz * sr) ** 2 + (cz * cr - sl * sz) ** 2)


@dataclass(frozen=True)
class SheetGyroid(_Periodic):
    """The wall |f| < level around the gyroid surface f = 0.

    Args:
        cell: Period [mm].
        level: Above 0 and below √2, dimensionless.
    """

    level: float = 0.5

    def __post_init__(self) -> None:
        _checked(self, self.level, 0.0, GYROID_PINCH, "beyond, the wall closes its own channels")

    def _sampled(self, x: Array, y: Array, z: Array, *, slopes: bool) -> Sampled:
        value, slope = _gyroid(x, y, z, slopes)
        return np.abs(value) - self.level, slope


@dataclass(frozen=True)
class SkeletalGyroid(_Periodic):
    """One of the two channels of the gyroid, f + level < 0.

    Args:
        cell: Period [mm].
        level: Within ±√2, dimensionless.
    """

    level: float = 1.2

    def __post_init__(self) -> None:
        _checked(self, self.level, -GYROID_PINCH, GYROID_PINCH, "beyond, the skeleton or its void falls apart")

    def _sampled(self, x: Array, y: Array, z: Array, *, slopes: bool) -> Sampled:
        value, slope = _gyroid(x, y, z, slopes)
        return value + self.level, slope


@dataclass(frozen=True)
class SchwarzP(_Periodic):
    """cos ρ + cos l + cos z − level < 0.

    Args:
        cell: Period [mm].
        level: Within ±1, where the necks pinch off, dimensionless.
    """

    level: float = 0.8

    def __post_init__(self) -> None:
        _checked(self, self.level, -1.0, 1.0, "at 1 and −1 the necks pinch off")

    def _sampled(self, x: Array, y: Array, z: Array, *, slopes: bool) -> Sampled:
        value = np.cos(x) + np.cos(y) + np.cos(z) - self.level
        return value, np.sqrt(np.sin(x) ** 2 + np.sin(y) ** 2 + np.sin(z) ** 2) if slopes else value


@dataclass(frozen=True)
class SkeletalDiamond(_Periodic):
    """cos ρ cos l cos z − sin ρ sin l sin z + level < 0.

    Args:
        cell: Period [mm].
        level: Within ±√½, dimensionless.
    """

    level: float = 0.5

    def __post_init__(self) -> None:
        _checked(self, self.level, -DIAMOND_PINCH, DIAMOND_PINCH, "beyond, the skeleton or its void falls apart")

    def _sampled(self, x: Array, y: Array, z: Array, *, slopes: bool) -> Sampled:
        (sx, sy, sz), (cx, cy, cz) = (np.sin(x), np.sin(y), np.sin(z)), (np.cos(x), np.cos(y), np.cos(z))
        value = cx * cy * cz - sx * sy * sz + self.level
        if not slopes:
            return value, value
        slope = (sx * cy * cz + cx * sy * sz) ** 2 + (cx * sy * cz + sx * cy * sz) ** 2
        return value, np.sqrt(slope + (cx * cy * sz + sx * sy * cz) ** 2)

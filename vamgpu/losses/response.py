"""Response of a resin to a dose: models that are sampled once and looked up on the device."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, isfinite
from typing import Protocol

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.geometry import positive
from vamgpu.schema.quantities import numeric

SAMPLES = 1024
REACH = 3.0  # largest sampled dose; curves are sampled from 0 and continue straight beyond it


@dataclass(frozen=True, eq=False)
class Curve:
    """Samples of a response, at the doses ``start`` + k / ``density``."""

    values: np.ndarray
    start: float
    density: float


class Response(Protocol):
    """Response of the resin to a dose in units of the part's."""

    def curve(self) -> Curve:
        """Sample the response.

        Returns:
            Samples that a device interpolates.
        """
        ...


def _sampled(function: np.ufunc | object) -> Curve:
    doses = np.linspace(0.0, REACH, SAMPLES)
    return Curve(function(doses), 0.0, (SAMPLES - 1) / REACH)  # type: ignore[operator]


@dataclass(frozen=True)
class Linear(Response):
    """M(d) = gain·d.

    Args:
        gain: Slope above 0, dimensionless.
    """

    gain: float = 1.0

    def __post_init__(self) -> None:
        positive("Linear gain", self.gain)

    def curve(self) -> Curve:
        return Curve(np.array([0.0, self.gain]), 0.0, 1.0)


@dataclass(frozen=True)
class Logistic(Response):
    """M(d) = 1 / (1 + exp(−steepness·(d − middle))).

    Args:
        steepness: Steepness relative to the part's dose, above 0.
        middle: Dose at which M is one half, relative to the part's.
    """

    steepness: float = 10.0
    middle: float = 0.5

    def __post_init__(self) -> None:
        positive("Logistic steepness", self.steepness)
        positive("Logistic middle", self.middle, zero=True)

    def curve(self) -> Curve:
        return GeneralizedLogistic(steepness=self.steepness, middle=self.middle).curve()


@dataclass(frozen=True)
class GeneralizedLogistic(Response):
    """M(d) = low + (high − low) / (1 + exp(−steepness·(d − middle)))^(1/skew), Richards' curve.

    Args:
        low: M without light, dimensionless.
        high: M in the limit of high dose, dimensionless.
        steepness: Steepness relative to the part's dose, above 0.
        middle: Dose at the middle of the curve, relative to the part's.
        skew: Skew, above 0, dimensionless.

    Raises:
        BadInput: A value is out of its range.
    """

    low: float = 0.0
    high: float = 1.0
    steepness: float = 10.0
    middle: float = 0.5
    skew: float = 1.0

    def __post_init__(self) -> None:
        positive("GeneralizedLogistic steepness", self.steepness)
        positive("GeneralizedLogistic skew", self.skew)
        if not -inf < self.low < self.high < inf or not isfinite(self.middle):
            raise BadInput(
                f"GeneralizedLogistic goes from {self.low} to {self.high} about {self.middle}; expected finite low < "
                "high"
            )

    def curve(self) -> Curve:
        def richards(dose: np.ndarray) -> np.ndarray:
            growth = np.logaddexp(0.0, -self.steepness * (dose - self.middle)) / self.skew
            return self.low + (self.high - self.low) * np.exp(-growth)

        return _sampled(richards)


@dataclass(frozen=True)
class Interpolated(Response):
    """A measured response: linear between (dose, value) pairs.

    Args:
        doses: Doses relative to the part's, rising.
        values: M at each dose, dimensionless.

    Raises:
        BadInput: Doses do not rise, or there are not as many values as doses.
    """

    doses: tuple[float, ...]
    values: tuple[float, ...]

    def __post_init__(self) -> None:
        doses, values = numeric("Interpolated doses", self.doses), numeric("Interpolated values", self.values)
        if doses.shape != values.shape or len(doses) < 2 or (np.diff(doses) <= 0).any():
            raise BadInput(
                f"Interpolated got {doses.shape} doses and {values.shape} values; expected two pairs or more, rising"
            )

    def curve(self) -> Curve:
        return _sampled(lambda dose: np.interp(dose, self.doses, self.values))

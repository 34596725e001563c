"""Turbidity of curing resin, for light that does not cure: the resin scatters more, and bends light."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.geometry import positive
from vamgpu.schema.quantities import numeric


@dataclass(frozen=True)
class MeasuredTurbidity:
    """Extinction of fully cured resin, above that before the print, and its standard error [1/mm]."""

    full: float
    error: float


@dataclass(frozen=True)
class Turbidity:
    """Extinction and refractive index of resin against conversion, as changes from the resin before the print.

    Values between samples are interpolated linearly. All lists have the same length.

    Args:
        conversion: Samples, shares in 0..1, dimensionless, ascending, the first 0.
        extinction: Share of the camera's light lost per length, natural logarithm [1/mm]; ascending, the first 0.
        index: Change of the refractive index; empty for none.
        error: Relative error of the extinction, which the predicted overlap allows for, dimensionless.

    Raises:
        BadInput: The lists differ in length, or are out of order or range.
    """

    conversion: Sequence[float] = (0.0, 1.0)
    extinction: Sequence[float] = (0.0, 0.1)
    index: Sequence[float] = ()
    error: float = 0.0

    def __post_init__(self) -> None:
        for name in ("conversion", "extinction", "index"):
            samples = numeric(name, getattr(self, name), axes=(), expected="a list of finite numbers")
            object.__setattr__(self, name, tuple(samples.ravel().tolist()))
        object.__setattr__(self, "error", positive("relative error of the turbidity", self.error, zero=True))
        for name, samples in (("conversion", self.conversion), ("extinction [1/mm]", self.extinction)):
            if len(samples) < 2 or samples[0] != 0.0 or (np.diff(samples) <= 0.0).any():
                raise BadInput(f"{name} is {list(samples)}; expected at least two numbers, ascending from 0")
        if self.conversion[-1] > 1.0:
            raise BadInput(f"conversion reaches {self.conversion[-1]:g}; expected shares in 0..1")
        lengths = {len(self.conversion), len(self.extinction), len(self.index) or len(self.conversion)}
        if len(lengths) > 1:
            raise BadInput(f"{self!r}: expected an extinction, and an index or none, for every conversion")

    @property
    def full(self) -> float:
        """Extinction of the last sample [1/mm]."""
        return self.extinction[-1]

    def extinction_at(self, conversion: np.ndarray) -> np.ndarray:
        """Extinction [1/mm] of a conversion, (...,).

        Args:
            conversion: Shares in 0..1, (...,).

        Returns:
            Extinction [1/mm], (...,).
        """
        return np.interp(conversion, self.conversion, self.extinction)

    def index_at(self, conversion: np.ndarray) -> np.ndarray:
        """Change of the refractive index at a conversion, (...,).

        Args:
            conversion: Shares in 0..1, (...,).

        Returns:
            Its change, (...,).
        """
        return np.interp(conversion, self.conversion, self.index or np.zeros(len(self.conversion)))

    def conversion_at(self, extinction: np.ndarray) -> np.ndarray:
        """Conversion for an extinction [1/mm], (...,); beyond the samples, that of the nearest sample.

        Args:
            extinction: Extinction above the resin's before the print [1/mm], (...,).

        Returns:
            Shares in 0..1, (...,).
        """
        return np.interp(extinction, self.extinction, self.conversion)

    def slope_at(self, extinction: np.ndarray) -> np.ndarray:
        """Conversion per extinction [mm], (...,): the ratio of their deviations.

        Args:
            extinction: Extinction above the resin's before the print [1/mm], (...,).

        Returns:
            Slope [mm], (...,).
        """
        piece = np.searchsorted(self.extinction, extinction, side="right") - 1
        return self.slopes[np.clip(piece, 0, self.slopes.size - 1)]

    @property
    def slopes(self) -> np.ndarray:
        """Conversion per extinction [mm] from each sample to the next, (samples - 1,)."""
        return np.diff(self.conversion) / np.diff(self.extinction)

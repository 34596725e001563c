"""Printing layer by layer (Pritchard et al. 2019, section S6): the platform stops while a slice is shown.

Slice n cures ζ = n − 1 to n, shown with the window at ζ = n; at every border the dose lacks the light beyond.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from vamgpu.curethrough.printer import LN10, Machine
from vamgpu.curethrough.profile import Flat, Profile
from vamgpu.curethrough.targets import NEVER, Targets
from vamgpu.errors import BadInput
from vamgpu.schema.quantities import ExposureTime


@dataclass(frozen=True)
class LayerPrinter(Machine):
    """A printer that stops for every slice.

    Args:
        absorption_height: h_a [mm], over which light falls to a tenth.
        critical_dose: D_c [mJ/mm³].
        slice_height: h_s [mm].
        exposure: t_e [s] of a slice.
        light: Irradiance at the window [mW/mm²] of the gray levels 0 to 255.

    Raises:
        BadInput: A value is out of range.
    """

    exposure: ExposureTime
    light: tuple[float, ...]

    layered: ClassVar[bool] = True

    def __post_init__(self) -> None:
        self._check(self.light)

    @property
    def tail(self) -> int:
        """None: a layer has all of its light when the next one begins."""
        return 0

    @property
    def opened(self) -> float:
        """Infinite: a void is open at any dose."""
        return 1e30

    @cached_property
    def phi(self) -> np.ndarray:
        """Φ′ of every gray level (S47); float64 [256]."""
        return np.array(self.light) * self.exposure * LN10 / (self.critical_dose * self.absorption_height)

    @property
    def doses(self) -> np.ndarray:
        """Ω that one slice of each level adds at its window; float64 [256]."""
        return self.phi

    @property
    def reached(self) -> float:
        """Ω beyond a layer at which full light still cures its far edge."""
        fade = 1.0 - self.decay
        return (1.0 / fade - self.phi[-1] - self.tolerance - 1e-6) / fade

    def between(self, fraction: float) -> tuple[float, float]:
        # Ω at ζ = n − fraction, from the window on; at 1 the limit from below (S48)
        self._check_fraction(fraction)
        return 1.0, 10.0 ** (-fraction * self.eta)

    def targets(self, profile: Profile = Flat()) -> Targets:
        # every layer's far edge gets the critical dose, and the void nothing (S49)
        floor = self.phi[0] / self.decay
        if floor >= 1.0:
            raise BadInput(
                f"level 0 builds up {floor:.3g} critical doses over many layers: nothing can stay uncured; "
                "expose shorter or darken level 0"
            )
        return Targets(np.array([[1.0 / (1.0 - self.decay)]]), np.array([NEVER]))

    @property
    def least_cure_through(self) -> float:
        """z_CT [mm]: height beyond a front that level 0 cures with any correction (S52).

        Holds for one slice, up to the slice height; beyond, later slices add to it.
        """
        return self.absorption_height * float(np.log10(self.phi[0] + 1.0))

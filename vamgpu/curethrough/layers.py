"""Printing layer by layer (Pritchard et al. 2019, section S6): the platform stands while a slice is shown.

Slice n cures the layer from ζ = n − 1 to n and is shown with the window at ζ = n. The dose jumps at every border: just
above one it lacks the light of the layer beyond, so it falls along a sawtooth.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from vamgpu.curethrough.printer import check_eta, measured_levels
from vamgpu.curethrough.profile import Flat, Profile
from vamgpu.curethrough.targets import NEVER, Targets
from vamgpu.errors import BadInput
from vamgpu.geometry import positive

LN10 = float(np.log(10.0))


def exposure_of_layer(absorption_height: float, critical_dose: float, slice_height: float, full: float) -> float:
    """t_e [s] at which full light [mW/mm²] just cures the far edge of a layer with nothing behind it (S53)."""
    return critical_dose * absorption_height * 10.0 ** (slice_height / absorption_height) / (full * LN10)


@dataclass(frozen=True)
class LayerPrinter:
    """A printer that stops for every slice; fields as in `Printer`, with ``exposure``: t_e [s] of a slice.

    Raises `BadInput`.
    """

    absorption_height: float
    critical_dose: float
    slice_height: float
    exposure: float
    light: tuple[float, ...]

    def __post_init__(self) -> None:
        for name, unit in (("absorption_height", "mm"), ("critical_dose", "mJ/mm³"), ("slice_height", "mm"),
                           ("exposure", "s")):  # fmt: skip
            object.__setattr__(self, name, positive(f"{name} [{unit}]", getattr(self, name)))
        object.__setattr__(self, "light", measured_levels(self.light))
        check_eta(self.slice_height, self.absorption_height)

    layered = True
    tail = 0
    opened = 1e30

    @property
    def eta(self) -> float:
        """η = h_s / h_a."""
        return self.slice_height / self.absorption_height

    @property
    def decay(self) -> float:
        """1 − 10^−η."""
        return float(-np.expm1(-self.eta * LN10))

    @cached_property
    def phi(self) -> np.ndarray:
        """Φ′ of every gray level (S47); float64 [256]."""
        return np.array(self.light) * self.exposure * LN10 / (self.critical_dose * self.absorption_height)

    @property
    def doses(self) -> np.ndarray:
        """Ω that one slice of each level adds at its window; float64 [256]."""
        return self.phi

    @property
    def fade_scale(self) -> float:
        """Slices over which light fades e-fold, negative."""
        return -1.0 / (self.eta * LN10)

    @property
    def tolerance(self) -> float:
        """Half of the largest step of Ω from one level to the next."""
        return 0.5 * float(np.diff(self.phi).max())

    @property
    def reached(self) -> float:
        """Ω beyond a layer with which full light still cures its far edge."""
        fade = 1.0 - self.decay
        return (1.0 / fade - self.phi[-1] - self.tolerance - 1e-6) / fade

    def between(self, fraction: float) -> tuple[float, float]:
        """Shares (part, fade) that give Ω at ζ = n − fraction, 0 ≤ fraction ≤ 1; at 1 the limit from below (S48)."""
        if not 0.0 <= fraction <= 1.0:
            raise BadInput(f"fraction is {fraction!r}; wanted 0 to 1, in slice heights from the window of the slice")
        return 1.0, 10.0 ** (-fraction * self.eta)

    def targets(self, profile: Profile = Flat()) -> Targets:
        """Every layer's far edge gets the critical dose, and the void nothing (S49). Raises `BadInput`."""
        floor = self.phi[0] / self.decay
        if floor >= 1.0:
            raise BadInput(
                f"level 0 builds up {floor:.3g} critical doses over many layers: nothing can stay uncured; "
                "expose shorter or darken level 0"
            )
        return Targets(np.array([[1.0 / (1.0 - self.decay)]]), np.array([NEVER]))

    @property
    def least_cure_through(self) -> float:
        """z_CT [mm]: height beyond a front that level 0 cures, whatever the correction does (S52).

        Holds for one slice, so up to the slice height; beyond, later slices add to it.
        """
        return self.absorption_height * float(np.log10(self.phi[0] + 1.0))

    @property
    def heterogeneity(self) -> float:
        """ω: greatest over least dose of a layer (S55)."""
        return 10.0**self.eta

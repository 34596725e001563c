"""A continuous printer and its resin, in the variables of the dose model."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from math import ceil, log10
from typing import Any, ClassVar

import numpy as np

from vamgpu.curethrough.profile import Flat, Profile
from vamgpu.curethrough.targets import NEVER, Targets, sampled
from vamgpu.errors import BadInput
from vamgpu.geometry import positive
from vamgpu.schema import check
from vamgpu.schema.quantities import Dose, Length, Speed, Thickness, numeric


# Curves that bound the dose inside a feature (Pritchard et al. 2019, eqs. S36 to S42), in Ω and slice heights. It
# reaches from ζ_U, its front, to ζ_L > ζ_U, its back side, which is exposed later. ζ may be an array.
def constant_light(zeta: Any, zeta_0: float, dose_0: float, phi: float, eta: float) -> np.ndarray:
    """Ω(ζ) under constant light Φ from the known Ω at ζ_0 (S36)."""
    fade = 10.0 ** ((np.asarray(zeta, dtype=np.float64) - zeta_0) * eta)
    return dose_0 * fade + phi * (1.0 - fade)


def build_up(zeta: Any, lower: float, phi_max: float, eta: float) -> np.ndarray:
    """Curve ii: the most dose that full light builds up from Ω_c at the back side ζ_L = ``lower`` (S37)."""
    return constant_light(zeta, lower, 1.0, phi_max, eta)


def die_down(zeta: Any, upper: float, phi_min: float, eta: float) -> np.ndarray:
    """Curve iii: the most dose that dies down to Ω_c at the front ζ_U = ``upper`` under least light (S38)."""
    return constant_light(zeta, upper, 1.0, phi_min, eta)


def build_up_slices(dose_0: float, phi: float, eta: float) -> float:
    """Slices of light Φ that bring Ω_0 to Ω_c: log10[(Φ − Ω_0) / (Φ − Ω_c)] / η; infinite where Φ never gets there."""
    if dose_0 >= 1.0:
        return 0.0
    return log10((phi - dose_0) / (phi - 1.0)) / eta if phi > 1.0 else float("inf")


LEVELS = 256
MOST_ETA = 30
LN10 = float(np.log(10.0))


def measured_levels(light: Any) -> tuple[float, ...]:
    """Light [mW/mm²] of levels 0 to 255 that never falls; else `BadInput`."""
    values = numeric("light", light, (1,), f"{LEVELS} finite numbers [mW/mm²], one per gray level")
    if values.shape != (LEVELS,) or (values < 0).any():
        raise BadInput(f"light has shape {values.shape}; expected {LEVELS} finite numbers ≥ 0, one per gray level")
    fall = np.flatnonzero(np.diff(values) < 0)
    if fall.size:
        at = int(fall[0])
        raise BadInput(
            f"light falls from {values[at]:g} at level {at} to {values[at + 1]:g} at the next; expected it to rise: "
            "fit the readings with fit_gray"
        )
    if values[-1] <= values[0]:
        raise BadInput(f"light is {values[0]:g} mW/mm² at level 0 and {values[-1]:g} at 255; expected more at 255")
    return tuple(values.tolist())


def levels_of(full: float, dark: float = 0.0, curve: Callable[[Any], Any] | None = None) -> tuple[float, ...]:
    """Light of every gray level: proportional, or from a curve.

    Args:
        full: Irradiance of level 255 [mW/mm²].
        dark: Irradiance of level 0 [mW/mm²].
        curve: Relative light of gray levels, such as a `GrayCurve`; its own black level replaces ``dark``.

    Returns:
        Irradiance of the levels 0 to 255 [mW/mm²].

    Raises:
        BadInput: Level 255 is no brighter than level 0.
    """
    top, floor = positive("full light [mW/mm²]", full), positive("dark light [mW/mm²]", dark, zero=True)
    numbers = np.arange(LEVELS)
    if curve is not None:
        return measured_levels(top * np.asarray(curve(numbers), dtype=np.float64))
    if floor >= top:
        raise BadInput(f"light is {floor:g} mW/mm² at level 0 (dark) and {top:g} at 255; expected more at 255")
    return measured_levels(floor + (top - floor) * numbers / (LEVELS - 1))


@dataclass(frozen=True)
class Machine(ABC):
    """A printer that lights a resin through a window; lengths along the print in slices, doses in D_c."""

    absorption_height: Length
    critical_dose: Dose
    slice_height: Length

    layered: ClassVar[bool]  # whether the platform stops while a slice is shown

    def _check(self, light: tuple[float, ...]) -> None:
        check(self)
        object.__setattr__(self, "light", measured_levels(light))
        if self.eta > MOST_ETA:  # 10^η would exceed float32
            raise BadInput(f"a slice is {self.slice_height:g} mm high, {self.eta:g} absorption heights; expected at "
                           f"most {MOST_ETA}: check both and their units")  # fmt: skip

    def _check_fraction(self, fraction: float) -> None:
        if not 0.0 <= fraction <= 1.0:
            raise BadInput(f"fraction is {fraction!r}; expected 0 to 1, in slice heights from the border of the slice")

    @property
    def eta(self) -> float:
        """η = h_s / h_a (S12)."""
        return self.slice_height / self.absorption_height

    @property
    def decay(self) -> float:
        """1 − 10^−η: share of the dose that is lost one slice higher."""
        return float(-np.expm1(-self.eta * LN10))

    @property
    def fade_scale(self) -> float:
        """Number of slices over which light falls by a factor e, negative."""
        return -1.0 / (self.eta * LN10)

    @property
    @abstractmethod
    def doses(self) -> np.ndarray:
        """Ω that one slice of each level adds at its border; float64 [256]."""

    @property
    def tolerance(self) -> float:
        """Half of the largest step of Ω from one level to the next."""
        return 0.5 * float(np.diff(self.doses).max())

    @property
    @abstractmethod
    def reached(self) -> float:
        """Ω behind a feature at which its back side counts as cured."""

    @property
    @abstractmethod
    def opened(self) -> float:
        """Ω to which a void must fall to be distinguished from its walls."""

    @property
    @abstractmethod
    def tail(self) -> int:
        """Number of slices to show after the last one to give its back side its dose."""

    @abstractmethod
    def between(self, fraction: float) -> tuple[float, float]:
        """Compute the factors of Ω within a slice.

        Args:
            fraction: Distance from the slice's border, a fraction of the slice height from 0 to 1.

        Returns:
            Share of the slice's own dose, and factor by which the dose of earlier slices decays.

        Raises:
            BadInput: The fraction is out of range.
        """

    @abstractmethod
    def targets(self, profile: Profile) -> Targets:
        """Compute the doses at which the correction aims.

        Args:
            profile: Dose inside features; layer printers use only the critical dose.

        Returns:
            The doses.

        Raises:
            BadInput: No correction can help: full light cures nothing, or level 0 everything.
        """


@dataclass(frozen=True)
class Printer(Machine):
    """A continuous printer: slice n lights the window while the window moves from ζ = n to n + 1.

    Args:
        absorption_height: h_a [mm], over which light falls to a tenth.
        critical_dose: D_c [mJ/mm³].
        slice_height: h_s [mm].
        speed: s [mm/s].
        light: Irradiance at the window [mW/mm²] of the gray levels 0 to 255; level 0 need not be dark.
        dead_zone: Layer [mm] at the window that a second color keeps liquid; it absorbs its share of the light, and
            slices are counted from its far side.

    Raises:
        BadInput: A value is out of range.
    """

    speed: Speed
    light: tuple[float, ...]
    dead_zone: Thickness = 0.0

    layered: ClassVar[bool] = False

    def __post_init__(self) -> None:
        self._check(self.light)

    @cached_property
    def phi(self) -> np.ndarray:
        """Φ of every gray level (S10), behind the dead zone; float64 [256]."""
        seen = 10.0 ** (-self.dead_zone / self.absorption_height)
        return np.array(self.light) * seen / (self.critical_dose * self.speed)  # by I_c, the least that cures (S25)

    @property
    def phi_min(self) -> float:
        """Φ of level 0, which is also the least dose wherever later light reached (S35)."""
        return float(self.phi[0])

    @property
    def phi_max(self) -> float:
        """Φ of level 255."""
        return float(self.phi[-1])

    @property
    def doses(self) -> np.ndarray:
        """Ω that one slice of each level adds where it begins; float64 [256]."""
        return self.phi * self.decay

    def between(self, fraction: float) -> tuple[float, float]:
        # Ω at ζ = n + fraction (S22)
        self._check_fraction(fraction)
        return float(-np.expm1(-(1.0 - fraction) * self.eta * LN10)) / self.decay, 1.0

    def at_speed(self, speed: float) -> Printer:
        """The same printer at another speed.

        Args:
            speed: s [mm/s].

        Returns:
            The other printer.
        """
        return replace(self, speed=speed)

    def build_up_height(self, dose: float = 0.0) -> float:
        """Height of full light that brings Ω to the critical dose.

        Args:
            dose: Ω before that, dimensionless: in critical doses.

        Returns:
            Height [mm]; infinite if full light never does.
        """
        return self.slice_height * build_up_slices(dose, self.phi_max, self.eta)

    @property
    def tail(self) -> int:
        """Slices to show after the last, so that its back side gets its dose; raises `BadInput` where none suffice."""
        slices = build_up_slices(0.0, self.phi_max, self.eta)
        if not np.isfinite(slices):
            raise BadInput(
                f"full light gives at most {self.phi_max:.3g} critical doses; expected more than 1: "
                f"print slower than {self.fastest():.3g} mm/s or with more light"
            )
        return ceil(slices - 1e-9)

    def fastest(self, height: float = float("inf")) -> float:
        """Speed at which full light just reaches the critical dose, starting from none.

        Args:
            height: Height of full light [mm].

        Returns:
            Speed [mm/s].
        """
        share = 1.0 - 10.0 ** (-height / self.absorption_height)
        return self.phi_max * self.speed * share

    def _check_correctable(self) -> None:
        """Reject a printer whose full light cures nothing, or whose level 0 cures everything it reaches."""
        if self.phi_min >= 1.0:
            raise BadInput(
                f"level 0 leaves {self.phi_min * self.critical_dose * 1e3:.4g} mJ/cm³ behind, the critical dose is "
                f"{self.critical_dose * 1e3:.4g}: nothing can stay uncured; print faster than "
                f"{self.phi_min * self.speed:.3g} mm/s or darken level 0"
            )
        self.tail  # noqa: B018 - raises

    def targets(self, profile: Profile = Flat()) -> Targets:
        # slice by slice: S37, S38 and the build-up in the void
        self._check_correctable()
        eta, low, high = self.eta, self.phi_min, self.phi_max
        back = build_up(-np.arange(0, -self.tail - 2, -1.0), 0.0, high, eta)
        back = np.append(np.where(back > 0.0, back, NEVER), NEVER)
        reach = log10((high - low) / (1.0 - low)) / eta
        done, left = np.arange(self.sight), np.arange(ceil(reach) + 2)
        profiled = sampled(profile, done * self.slice_height, left * self.slice_height)
        bound = die_down(left, 0.0, low, eta)
        bound[-1] = np.inf  # too far from the front to limit the dose
        inner = np.minimum(np.maximum(profiled, 1.0), np.minimum(bound, 2.0 * high))
        return Targets(inner, back)

    @property
    def reached(self) -> float:
        """Ω at which the back side of a feature counts as cured."""
        return 1.0 - self.tolerance - 1e-6

    @property
    def opened(self) -> float:
        """Ω to which a void must fall to be distinguished from its walls."""
        return 1.0 - 3.0 * self.tolerance - 1e-6

    @property
    def sight(self) -> int:
        """Number of slices from the back side over which an inner profile differs, until full light nears its limit."""
        return ceil(3.0 / self.eta) if self.eta > 0.003 else 1000

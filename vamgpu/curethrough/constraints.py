"""Curves that bound the dose inside a feature (Pritchard et al. 2019, eqs. S36 to S42), in Ω and slice heights.

A feature extends from ζ_U, its front, to ζ_L > ζ_U, its back side, which is exposed later. ζ may be an array.
"""

from __future__ import annotations

from math import log10
from typing import Any

import numpy as np


def constant_light(zeta: Any, zeta_0: float, dose_0: float, phi: float, eta: float) -> np.ndarray:
    """Ω(ζ) under constant light Φ, from the known Ω at ζ_0 (S36)."""
    fade = 10.0 ** ((np.asarray(zeta, dtype=np.float64) - zeta_0) * eta)
    return dose_0 * fade + phi * (1.0 - fade)


def build_up(zeta: Any, lower: float, phi_max: float, eta: float) -> np.ndarray:
    """Curve ii: the greatest dose that full light builds up from Ω_c at the back side ζ_L = ``lower`` (S37)."""
    return constant_light(zeta, lower, 1.0, phi_max, eta)


def die_down(zeta: Any, upper: float, phi_min: float, eta: float) -> np.ndarray:
    """Curve iii: the greatest dose that decays to Ω_c at the front ζ_U = ``upper`` under least light (S38)."""
    return constant_light(zeta, upper, 1.0, phi_min, eta)


def highest_place(upper: float, lower: float, phi_min: float, phi_max: float, eta: float) -> float:
    """ζ*, where curves ii and iii meet (S39)."""
    delta = lower - upper
    low = (1.0 - phi_min) - (1.0 - phi_max) * 10.0 ** (-delta * eta)
    return upper + log10((phi_max - phi_min) / low) / eta


def highest_dose(delta: Any, phi_min: float, phi_max: float, eta: float) -> np.ndarray:
    """Ω*, the greatest dose within a feature ``delta`` slices high (S42)."""
    fade = 10.0 ** (-np.asarray(delta, dtype=np.float64) * eta)
    room = (1.0 - phi_min) - (1.0 - phi_max) * fade
    return (1.0 - phi_min) * (phi_max - phi_min) / room + phi_min


def build_up_slices(dose_0: float, phi: float, eta: float) -> float:
    """Number of slices in which light Φ brings Ω_0 to Ω_c: log10[(Φ − Ω_0) / (Φ − Ω_c)] / η, or infinity."""
    if dose_0 >= 1.0:
        return 0.0
    return log10((phi - dose_0) / (phi - 1.0)) / eta if phi > 1.0 else float("inf")

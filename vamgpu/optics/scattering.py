"""Resin that scatters light: how often, and into which directions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.schema import check
from vamgpu.schema.quantities import NonNegative, ScatteringCoefficient, Turn, finite

STEPS = 1 << 14  # cosines between −1 and 1 at which a phase function is added up
SHARPEST = 0.98
"""Greatest anisotropy: beyond it, light is hardly turned, and a phase function that sharp is not sampled exactly."""


@dataclass(frozen=True)
class Scattering:
    """Scattering in a resin, the same everywhere: for `vamgpu.ScatteringRings` and ``[scattering]``.

    ``anisotropy`` is the mean cosine g of the scattering angle, for the phase function of Henyey and Greenstein
    (Astrophys. J. 93 (1941) 70), p(μ) ∝ (1 + g² − 2gμ)^(−3/2). Particles much smaller than the wavelength scatter as
    "rayleigh", p(μ) ∝ 1 + μ². A measured phase function replaces both.

    Args:
        coefficient: Scattering events per length μ_s [1/mm], not reduced by the anisotropy.
        anisotropy: Mean cosine of the scattering angle, dimensionless, −0.98 to 0.98; or "rayleigh".
        phase: Measured phase function: pairs of the scattering angle [rad], from 0 to π, and the intensity there per
            solid angle, in any unit. Intensities are linear between angles.

    Raises:
        BadInput: A value is out of its range, or angles do not rise from 0 to π.
    """

    coefficient: ScatteringCoefficient
    anisotropy: float | Literal["rayleigh"] = 0.9
    phase: tuple[tuple[Turn, NonNegative], ...] | None = None

    def __post_init__(self) -> None:
        check(self)
        g = 0.0 if self.anisotropy == "rayleigh" else self.anisotropy
        if isinstance(g, str) or abs(finite("Scattering anisotropy", g)) > SHARPEST:
            raise BadInput(f"Scattering anisotropy is {g!r}; expected −{SHARPEST} to {SHARPEST}, a number without "
                           "quotes, or 'rayleigh': it is the mean cosine of the angle")  # fmt: skip
        if self.phase is not None:
            object.__setattr__(self, "phase", _rising(self.phase))

    def density(self, cosine: np.ndarray) -> np.ndarray:
        """The phase function.

        Args:
            cosine: Cosines of the scattering angle, (...,).

        Returns:
            Light per solid angle, relative to isotropic light, (...,).
        """
        if self.phase is not None:
            angle, intensity = np.array(self.phase).T
            return np.interp(np.arccos(cosine), angle, intensity) / _mean(angle, intensity)
        if self.anisotropy == "rayleigh":
            return 0.75 * (1.0 + cosine**2)
        g = float(self.anisotropy)
        return (1.0 - g * g) / (1.0 + g * g - 2.0 * g * cosine) ** 1.5

    def cosines(self, count: int) -> np.ndarray:
        """Cosines of the scattering angle at even quantiles.

        Args:
            count: Number of intervals.

        Returns:
            Cosines, from −1 to 1, (count + 1,).
        """
        share = np.linspace(0.0, 1.0, count + 1)
        g = 0.0 if self.anisotropy == "rayleigh" else float(self.anisotropy)
        if self.phase is None and self.anisotropy != "rayleigh" and abs(g) > 1e-3:
            root = (1.0 - g * g) / (1.0 - g + 2.0 * g * share)
            return np.clip((1.0 + g * g - root * root) / (2.0 * g), -1.0, 1.0)
        angle = np.linspace(np.pi, 0.0, STEPS + 1)  # even angles resolve a forward peak
        middle = 0.5 * (angle[1:] + angle[:-1])
        light = np.concatenate([[0.0], np.cumsum(self.density(np.cos(middle)) * np.diff(np.cos(angle)))])
        rising = np.concatenate([[True], np.diff(light) > 0.0])
        found = np.interp(share * light[-1], light[rising], np.cos(angle)[rising])
        return np.clip(found, -1.0, 1.0)


def _rising(phase: object) -> tuple[tuple[float, float], ...]:
    """A measured phase function; raises `BadInput` unless its angles rise from 0 to π and some of it is not dark."""
    try:
        rows = np.array(phase, np.float64)
    except (TypeError, ValueError) as error:
        raise BadInput(f"Scattering phase is {phase!r}; expected pairs of an angle [rad] and an intensity, or none: "
                       "anisotropy sets the phase function of Henyey and Greenstein") from error  # fmt: skip
    if rows.ndim != 2 or rows.shape[1] != 2 or len(rows) < 2:
        raise BadInput(f"Scattering phase has shape {rows.shape}; expected pairs of angle and intensity, two or more")
    angle, intensity = rows.T
    if not (intensity >= 0.0).all():
        raise BadInput(f"Scattering phase has the intensity {np.nanmin(intensity):g}; expected numbers ≥ 0")
    if (np.diff(angle) <= 0.0).any() or abs(angle[0]) > 1e-6 or abs(angle[-1] - np.pi) > 1e-3 or not intensity.any():
        raise BadInput(f"Scattering phase has {len(rows)} angles from {np.degrees(angle[0]):g}° to "
                       f"{np.degrees(angle[-1]):g}°; expected them to rise from 0° to 180°, with light at some: extend "
                       "the measurement to both ends")  # fmt: skip
    return tuple((float(a), float(b)) for a, b in rows)


def _mean(angle: np.ndarray, intensity: np.ndarray) -> float:
    """Mean over all directions of an intensity that is linear between angles."""
    places = np.linspace(0.0, np.pi, STEPS + 1)
    edges = -np.cos(places)
    return float(np.sum(np.interp(0.5 * (places[1:] + places[:-1]), angle, intensity) * np.diff(edges)) / 2.0)

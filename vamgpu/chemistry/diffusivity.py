"""Diffusivity and diffusion length of inhibitors in a resin."""

from __future__ import annotations

from math import sqrt

from vamgpu.geometry import positive
from vamgpu.units import Pa_s, kg_m3

WILKE_CHANG = "C. R. Wilke, P. Chang, Correlation of diffusion coefficients in dilute solutions, AIChE J. 1 (1955) 264"
_CENTIPOISE = 1e-3 * Pa_s
_GRAM_PER_ML = 1e3 * kg_m3


def wilke_chang(
    *, temperature: float, viscosity: float, solvent: float, solute: float, density: float, association: float = 1.0
) -> float:
    """Diffusivity [mm²/s] of a dilute solute, estimated by Wilke and Chang. Raises `BadInput`."""
    mass = positive("association", association) * positive("molar mass of the solvent [g/mol]", solvent)
    thin = positive("viscosity [mJ·s/mm³]", viscosity) / _CENTIPOISE
    per_volume = positive("density [mJ·s²/mm⁵]", density) / _GRAM_PER_ML
    volume = positive("molar mass of the solute [g/mol]", solute) / per_volume
    return 7.4e-6 * sqrt(mass) * positive("temperature [K]", temperature) / thin * volume**-0.6


def diffusion_length(diffusivity: float, seconds: float) -> float:
    """√(6Dτ) [mm]: root mean square distance in space after ``seconds``; diffusivity in mm²/s. Raises `BadInput`."""
    return sqrt(6.0 * positive("diffusivity [mm²/s]", diffusivity) * positive("seconds", seconds, zero=True))

"""How fast inhibitors diffuse in a resin, and how far."""

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
    """Diffusivity [mm²/s] of a dilute solute after Wilke and Chang, eq. 11 of the photoinhibition paper: an estimate.

    temperature: [K].  viscosity: of the solvent [mJ·s/mm³], as ``18.8 * units.Pa_s``.  solvent, solute: molar masses
    [g/mol], the solvent's an average.  density: of the solute as a liquid at its boiling point [mJ·s²/mm⁵], as
    ``1140 * units.kg_m3``.  association: of the solvent, 1 where it does not associate.  Raises `BadInput`.
    """
    mass = positive("association", association) * positive("molar mass of the solvent [g/mol]", solvent)
    thin = positive("viscosity [mJ·s/mm³]", viscosity) / _CENTIPOISE
    per_volume = positive("density [mJ·s²/mm⁵]", density) / _GRAM_PER_ML
    volume = positive("molar mass of the solute [g/mol]", solute) / per_volume
    return 7.4e-6 * sqrt(mass) * positive("temperature [K]", temperature) / thin * volume**-0.6


def diffusion_length(diffusivity: float, seconds: float) -> float:
    """√(6Dτ) [mm]: root mean square distance in space after ``seconds``; diffusivity in mm²/s. Raises `BadInput`."""
    return sqrt(6.0 * positive("diffusivity [mm²/s]", diffusivity) * positive("seconds", seconds, zero=True))

"""Resins."""

from __future__ import annotations

from math import sqrt
from typing import Annotated, Any, ClassVar

from vamgpu.chemistry.materials.dispersion import Dispersion
from vamgpu.chemistry.materials.library import Absorbing, Material
from vamgpu.chemistry.materials.source import (
    Concentration,
    CriticalDose,
    Density,
    Duration,
    MolarMass,
    Share,
    Source,
    Temperature,
    Viscosity,
)
from vamgpu.errors import MaterialError, OutsideData
from vamgpu.geometry import positive
from vamgpu.schema.section import Listed, Section
from vamgpu.units import Pa_s, kg_m3

WILKE_CHANG = "C. R. Wilke, P. Chang, Correlation of diffusion coefficients in dilute solutions, AIChE J. 1 (1955) 264"
_CENTIPOISE = 1e-3 * Pa_s
_GRAM_PER_ML = 1e3 * kg_m3


class Inhibitor(Material):
    """A dissolved inhibitor. Numbers have a ``.value`` and its ``.source``; unknown ones are None.

    Args:
        name: Name.
        molar_mass: Molar mass [g/mol].
        density: Density of the liquid at its boiling point [mJ·s²/mm⁵].
        lifetime: Natural lifetime [s].
    """

    folder: ClassVar[str] = "inhibitors"
    molar_mass: MolarMass | None = None
    density: Density | None = None
    lifetime: Duration | None = None


class Component(Section):
    """A component of a resin. At most one of share and concentration is given, the one in the source.

    Args:
        name: Name.
        role: Role, such as "monomer" or "photoinitiator".
        share: Share of the mass, 0..1.
        concentration: Concentration [mol/m³].
        source: Source of the number.
    """

    name: str
    role: str
    share: Share | None = None
    concentration: Concentration | None = None
    source: Source | None = None


class Resin(Absorbing):
    """A resin with the numbers from its sources, or None. Numbers have a ``.value`` and its ``.source``.

    Args:
        name: Name.
        components: Components of the mixture.
        viscosity: Dynamic viscosity [mJ·s/mm³].
        molar_mass: Average molar mass [g/mol].
        temperature: Temperature [K] at which it is used.
        oxygen: Oxygen dissolved in air-saturated resin [mol/m³].
        critical_dose: Dose [mJ/mm³] from which it is solid.
        index, extinction: Refractive index and absorption by wavelength.
        note: Further remarks for the reader.
    """

    folder: ClassVar[str] = "resins"
    components: Annotated[tuple[Component, ...], Listed] = ()
    viscosity: Viscosity | None = None
    molar_mass: MolarMass | None = None
    temperature: Temperature | None = None
    oxygen: Concentration | None = None
    critical_dose: CriticalDose | None = None
    index: Dispersion | None = None
    note: str = ""

    def refraction(self, wavelength: float) -> float:
        """Refractive index at a wavelength.

        Args:
            wavelength: In vacuum [mm].

        Returns:
            Refractive index, dimensionless.

        Raises:
            OutsideData: No source covers that wavelength.
        """
        if self.index is None:
            raise OutsideData(f"no source gives the index of {self.name}; add an [index] table in a file of your own")
        return self.index.at(wavelength)

    def diffusivity(
        self, inhibitor: str | Inhibitor, *, temperature: float | None = None, molar_mass: float | None = None
    ) -> float:
        """Estimate the diffusivity of an inhibitor after Wilke and Chang, with this resin as the solvent.

        Args:
            inhibitor: An inhibitor, or the name of one.
            temperature: Temperature [K]; the resin's own by default.
            molar_mass: Molar mass [g/mol]; the resin's own by default.

        Returns:
            Diffusivity [mm²/s].

        Raises:
            MaterialError: A number is missing.
        """
        solute = Inhibitor.load(inhibitor) if isinstance(inhibitor, str) else inhibitor
        return wilke_chang(
            temperature=_known(self.name, "temperature", temperature, self.temperature),
            viscosity=_known(self.name, "viscosity", None, self.viscosity),
            solvent=_known(self.name, "molar_mass", molar_mass, self.molar_mass),
            solute=_known(solute.name, "molar_mass", None, solute.molar_mass),
            density=_known(solute.name, "density", None, solute.density),
        )


def _known(owner: str, name: str, given: float | None, table: Any) -> float:
    if given is not None:
        return given
    if table is None:
        raise MaterialError(f"no source gives the {name} of {owner}; pass it, or write it into a file of your own")
    return table.value


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

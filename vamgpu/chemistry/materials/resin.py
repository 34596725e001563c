"""Resins."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator

from vamgpu.chemistry.diffusivity import wilke_chang
from vamgpu.chemistry.materials import library
from vamgpu.chemistry.materials.clear import absorption_of
from vamgpu.chemistry.materials.dispersion import Dispersion
from vamgpu.chemistry.materials.extinction import Extinction
from vamgpu.chemistry.materials.inhibitor import Inhibitor
from vamgpu.chemistry.materials.sourced import (
    Concentration,
    CriticalDose,
    MolarMass,
    Share,
    Source,
    Sourced,
    Temperature,
    Viscosity,
    tupled,
)
from vamgpu.errors import MaterialError, OutsideData


class Component(Sourced):
    """What a resin is mixed from.

    share: of the mass, 0..1.  concentration: [mol/m³].  At most one is given: the one that the source gives.
    """

    name: str
    role: str
    share: Share | None = None
    concentration: Concentration | None = None
    source: Source | None = None


class Resin(Sourced):
    """A resin and what its sources say of it; None for what they do not.

    viscosity: [mJ·s/mm³], as the rest ``.value`` with its ``.source``.  molar_mass: average [g/mol].  temperature: at
    which it is used [K].  oxygen: dissolved in air-saturated resin [mol/m³].  critical_dose: from which it is
    solid [mJ/mm³].  index, extinction: against wavelength.
    """

    name: str
    components: Annotated[tuple[Component, ...], BeforeValidator(tupled)] = ()
    viscosity: Viscosity | None = None
    molar_mass: MolarMass | None = None
    temperature: Temperature | None = None
    oxygen: Concentration | None = None
    critical_dose: CriticalDose | None = None
    index: Dispersion | None = None
    extinction: Extinction | None = None
    note: str = ""

    @classmethod
    def load(cls, name: str | Path) -> Resin:
        """A bundled resin by its name, or the file at a path. Raises `MaterialError`."""
        return library.load(cls, "resins", name)

    @classmethod
    def names(cls) -> tuple[str, ...]:
        """The bundled resins."""
        return library.bundled("resins")

    def refraction(self, wavelength: float) -> float:
        """Refractive index at a wavelength [mm]. Raises `OutsideData`."""
        if self.index is None:
            raise OutsideData(f"no source gives the index of {self.name}; add an [index] table in a file of your own")
        return self.index.at(wavelength)

    def absorption(self, wavelength: float) -> float:
        """Absorption [1/mm] at a wavelength [mm]. Raises `OutsideData`."""
        return absorption_of(self.name, self.extinction, wavelength)

    def diffusivity(
        self, inhibitor: str | Inhibitor, *, temperature: float | None = None, molar_mass: float | None = None
    ) -> float:
        """Diffusivity [mm²/s] of an inhibitor, estimated after Wilke and Chang with this resin as the solvent.

        temperature [K] and molar_mass [g/mol] replace the resin's own. Raises `MaterialError` for what is missing.
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

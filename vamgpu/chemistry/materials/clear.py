"""What light passes on its way to the resin: glasses and liquids."""

from __future__ import annotations

from pathlib import Path

from vamgpu.chemistry.materials import library
from vamgpu.chemistry.materials.dispersion import Dispersion
from vamgpu.chemistry.materials.extinction import Extinction
from vamgpu.chemistry.materials.sourced import Density, Sourced


class Clear(Sourced):
    """A transparent material: its refractive index, what it absorbs, its density; None where no source says."""

    name: str
    index: Dispersion
    extinction: Extinction | None = None
    density: Density | None = None
    note: str = ""

    def absorption(self, wavelength: float) -> float:
        """Absorption [1/mm] at a wavelength [mm]. Raises `OutsideData` where there are no data."""
        return absorption_of(self.name, self.extinction, wavelength)


class Glass(Clear):
    """A solid wall or window."""

    @classmethod
    def load(cls, name: str | Path) -> Glass:
        """A bundled glass by its name, or the file at a path. Raises `MaterialError`."""
        return library.load(cls, "glasses", name)

    @classmethod
    def names(cls) -> tuple[str, ...]:
        """The bundled glasses."""
        return library.bundled("glasses")


class Liquid(Clear):
    """A bath around a vial."""

    @classmethod
    def load(cls, name: str | Path) -> Liquid:
        """A bundled liquid by its name, or the file at a path. Raises `MaterialError`."""
        return library.load(cls, "liquids", name)

    @classmethod
    def names(cls) -> tuple[str, ...]:
        """The bundled liquids."""
        return library.bundled("liquids")


def absorption_of(name: str, extinction: Extinction | None, wavelength: float) -> float:
    """Absorption [1/mm] where there may be no data. Raises `OutsideData`."""
    if extinction is None:
        from vamgpu.errors import OutsideData

        raise OutsideData(f"no source gives the absorption of {name}; add an [extinction] table in a file of your own")
    return extinction.at(wavelength)

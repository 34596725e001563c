"""Glasses and liquids that light passes on its way to the resin."""

from __future__ import annotations

from typing import ClassVar

from vamgpu.chemistry.materials.dispersion import Dispersion
from vamgpu.chemistry.materials.library import Absorbing
from vamgpu.chemistry.materials.source import Density


class Clear(Absorbing):
    """A transparent material: refractive index, absorption and density; None if no source gives them.

    Args:
        name: Name.
        index: Refractive index by wavelength.
        extinction: Absorption by wavelength.
        density: Density [mJ·s²/mm⁵].
        note: Further remarks for the reader.
    """

    index: Dispersion
    density: Density | None = None
    note: str = ""


class Glass(Clear):
    """A solid wall or window.

    Args:
        name, index, extinction, density, note: As for `Clear`, density in [mJ·s²/mm⁵].
    """

    folder: ClassVar[str] = "glasses"


class Liquid(Clear):
    """A bath around a vial.

    Args:
        name, index, extinction, density, note: As for `Clear`, density in [mJ·s²/mm⁵].
    """

    folder: ClassVar[str] = "liquids"

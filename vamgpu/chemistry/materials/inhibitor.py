"""Species that inhibit curing."""

from __future__ import annotations

from typing import ClassVar

from vamgpu.chemistry.materials.library import Material
from vamgpu.chemistry.materials.source import Density, Duration, MolarMass


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

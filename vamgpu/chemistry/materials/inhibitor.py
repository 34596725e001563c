"""Species that keep a resin from curing."""

from __future__ import annotations

from pathlib import Path

from vamgpu.chemistry.materials import library
from vamgpu.chemistry.materials.sourced import Density, Duration, MolarMass, Sourced


class Inhibitor(Sourced):
    """A dissolved inhibitor.

    molar_mass: [g/mol].  density: as a liquid at its boiling point [mJ·s²/mm⁵].  lifetime: how long it lasts by itself
    [s].  Each is ``.value`` with its ``.source``; what no source gives is None.
    """

    name: str
    molar_mass: MolarMass | None = None
    density: Density | None = None
    lifetime: Duration | None = None

    @classmethod
    def load(cls, name: str | Path) -> Inhibitor:
        """A bundled inhibitor ("oxygen", "lophyl"), or the file at a path. Raises `MaterialError`."""
        return library.load(cls, "inhibitors", name)

    @classmethod
    def names(cls) -> tuple[str, ...]:
        """The bundled inhibitors."""
        return library.bundled("inhibitors")

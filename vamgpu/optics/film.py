"""A film of resin on a web, as light meets it."""

from __future__ import annotations

from dataclasses import dataclass
from math import asin, inf, log, pi

from vamgpu.errors import BadInput
from vamgpu.geometry import positive
from vamgpu.optics.faces import Face
from vamgpu.optics.inputs import index
from vamgpu.schema import check
from vamgpu.schema.quantities import Absorption, Index, Length

NEGLIGIBLE = 0.05
"""Share of the light below which it is left out of a window (Toombs et al., S11)."""


@dataclass(frozen=True)
class Film:
    """A film that absorbs, in a bath, with or without a clear substrate on the side of the light.

    thickness: of the resin [mm].  resin_index, bath_index: refractive indices.  absorption: of the resin, natural
    logarithm [1/mm]; 0 for resin that only passes light on.  substrate: (thickness [mm], index) of a clear sheet
    between bath and resin.  The substrate a film is carried on, between resin and roller, sees no light: add its
    thickness to the roller's radius.

    Raises `BadInput`: a value is not finite or out of range, an index is below 1, or the film is thicker than light
    penetrates (`penetration`), so that its far side cannot be printed.
    """

    thickness: Length
    resin_index: Index
    bath_index: Index = 1.0
    absorption: Absorption = 0.0
    substrate: tuple[Length, Index] | None = None

    def __post_init__(self) -> None:
        check(self)
        if self.substrate is not None:
            object.__setattr__(self, "substrate", _sheet(self.substrate))
        if self.thickness > self.penetration:
            raise BadInput(f"the film is {self.thickness:g} mm thick, but with an absorption of {self.absorption:g} "
                           f"/mm light falls to {NEGLIGIBLE:.0%} within {self.penetration:.4g} mm; wanted a thinner "
                           f"film; at this thickness the absorption may be {-log(NEGLIGIBLE) / self.thickness:.4g} /mm")

    @property
    def penetration(self) -> float:
        """Depth [mm] in which light falls to 5 %: L = −ln(0.05)/α (S11, with the sign it misses); inf without α."""
        return -log(NEGLIGIBLE) / self.absorption if self.absorption > 0 else inf

    @property
    def ratio(self) -> float:
        """m: index of the bath over the index of the resin."""
        return self.bath_index / self.resin_index

    @property
    def coverage(self) -> float:
        """Range [rad] of the angles to the normal at which light crosses the outer face: 2·asin(m) (S11)."""
        return 2.0 * asin(min(1.0, self.ratio)) if self.ratio < 1 else pi

    def faces(self, radius: float) -> tuple[Face, ...]:
        """The faces light crosses where the film is wrapped about a roller of this radius [mm], from the outside in."""
        outer = radius + self.thickness
        if self.substrate is None:
            return (Face(outer, self.bath_index, self.resin_index, self.bath_index),)
        thick, sheet = self.substrate
        return (Face(outer + thick, self.bath_index, sheet, self.bath_index),
                Face(outer, sheet, self.resin_index, self.bath_index))


def _sheet(value: object) -> tuple[float, float]:
    try:
        thick, refraction = value  # type: ignore[misc]
    except (TypeError, ValueError) as error:
        raise BadInput(f"Film substrate is {value!r}; wanted (thickness [mm], index) or None") from error
    return positive("Film substrate thickness [mm]", thick), index("Film substrate index", refraction)

"""A film of resin on a web, for light."""

from __future__ import annotations

from dataclasses import dataclass
from math import asin, inf, log, pi, sin

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.optics.faces import Face, transmit
from vamgpu.schema import check
from vamgpu.schema.quantities import Absorption, Index, Length, measured

NEGLIGIBLE = 0.05  # share of the light below which it does not count for the window of light (Toombs et al., S11)


@dataclass(frozen=True)
class Film:
    """An absorbing film in a bath, with or without a clear substrate on the side of the light.

    Light does not reach a substrate between resin and roller; in that case, add its thickness to the roller's radius.

    Args:
        thickness: Thickness of the resin [mm].
        resin_index: Refractive index of the resin.
        bath_index: Refractive index of the bath.
        absorption: Absorption of the resin, natural logarithm [1/mm]; 0 for clear resin.
        substrate: Thickness [mm] and index of a clear sheet between bath and resin.

    Raises:
        BadInput: A value is out of its range, or the film is thicker than the light penetrates, and its far side cannot
            be printed.
    """

    thickness: Length
    resin_index: Index
    bath_index: Index = 1.0
    absorption: Absorption = 0.0
    substrate: tuple[Length, Index] | None = None

    def __post_init__(self) -> None:
        check(self)
        if self.substrate is not None:
            if not isinstance(self.substrate, (tuple, list)) or len(self.substrate) != 2:
                raise BadInput(f"Film substrate is {self.substrate!r}; expected (thickness [mm], index) or None")
            thick, index = self.substrate
            sheet = measured("Film substrate thickness", thick, Length), measured("Film substrate index", index, Index)
            object.__setattr__(self, "substrate", sheet)
        if self.thickness > self.penetration:
            raise BadInput(
                f"the film is {self.thickness:g} mm thick, but with an absorption of {self.absorption:g} "
                f"/mm light falls to {NEGLIGIBLE:.0%} within {self.penetration:.4g} mm; expected a thinner "
                f"film; at this thickness the absorption may be {-log(NEGLIGIBLE) / self.thickness:.4g} /mm"
            )

    @property
    def penetration(self) -> float:
        """Depth [mm] in which light falls to 5 %: L = −ln(0.05)/α (S11, whose sign is missing); inf if α is 0."""
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
        """The faces that light crosses if the film is wrapped about a roller.

        Args:
            radius: Radius of the roller [mm].

        Returns:
            The faces from the outside in.
        """
        outer = radius + self.thickness
        if self.substrate is None:
            return (Face(outer, self.bath_index, self.resin_index, self.bath_index),)
        thick, sheet = self.substrate
        return (
            Face(outer + thick, self.bath_index, sheet, self.bath_index),
            Face(outer, sheet, self.resin_index, self.bath_index),
        )


@dataclass(frozen=True)
class Coverage:
    """Range of angles to the normal of the film, both sides together [rad]."""

    outer: float  # for light behind the outer face, 2·asin(m) (Toombs et al., S11)
    inner: float  # for light at the roller: larger, because the normal turns as a ray goes inwards
    limit: float  # largest gain
    clipped: float  # angle of incidence in the bath above which 1/T exceeds the limit
    lost: float  # part of ``outer`` that is clipped


def coverage(film: Film, radius: float, limit: float, polarization: str = "none") -> Coverage:
    """Coverage of a film on a roller of this radius [mm] by polarized light. Raises `BadInput` for a limit below 1."""
    if not limit >= 1.0:
        raise BadInput(f"the largest gain is {limit!r}; expected at least 1")
    outer, faces = radius + film.thickness, film.faces(radius)
    reach = min(outer, *(face.aperture for face in faces))
    low, high = 0.0, reach
    for _ in range(80):
        middle = 0.5 * (low + high)
        through = float(transmit(faces, np.array(middle), polarization))
        low, high = (middle, high) if through >= 1.0 / limit else (low, middle)
    enters = asin(min(1.0, film.ratio * reach / outer))
    clipped = asin(low / outer)
    kept = asin(min(1.0, film.ratio * sin(clipped)))
    inner = asin(min(1.0, film.ratio * reach / radius))
    return Coverage(2.0 * enters, 2.0 * inner, limit, clipped, 2.0 * (enters - kept))

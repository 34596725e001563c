"""A round vial in a round jacket of liquid: two walls with a clear liquid between them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.optics.faces import Face
from vamgpu.optics.inputs import Floats
from vamgpu.optics.vial import Vial
from vamgpu.schema.quantities import Absorption, Index, Thickness


@dataclass(frozen=True, kw_only=True)
class DoubleWalledVial(Vial):
    """A round vial of resin inside a round wall, with a liquid between the two walls.

    From the outside in: bath, wall, liquid, inner wall, resin; all concentric. Light refracts at every face with
    Fresnel's loss, as in `Vial`, and the walls and the liquid absorb. A layer of thickness 0 has no effect: with gap
    and inner_wall 0 this is the `Vial`.

    Args:
        radius: Outer radius of the outer wall [mm].
        wall: Thickness of the outer wall [mm].
        wall_index: Refractive index of the outer wall.
        gap: Thickness of the liquid between the walls [mm].
        liquid_index: Refractive index of the liquid.
        inner_wall: Thickness of the inner wall [mm].
        inner_wall_index: Refractive index of the inner wall; None for that of the outer wall.
        wall_absorption: Absorption of both walls, natural logarithm [1/mm].
        liquid_absorption: Absorption of the liquid, natural logarithm [1/mm].
        resin_index: Refractive index of the resin.
        bath_index: Refractive index around the vial.
        absorption: Absorption of the resin, natural logarithm [1/mm].
        polarization: Polarization of the light, as for `Vial`.

    Raises:
        BadInput: As `Vial`, or the layers leave no space for resin.
    """

    gap: Thickness
    liquid_index: Index
    inner_wall: Thickness
    inner_wall_index: Index | None = None
    wall_absorption: Absorption = 0.0
    liquid_absorption: Absorption = 0.0
    barrier: ClassVar[str] = "wall or liquid"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.inner_radius <= 0.0:
            raise BadInput(
                f"walls and liquid are {self.wall + self.gap + self.inner_wall:g} mm thick in a vial of outer radius "
                f"{self.radius:g} mm; expected less than the radius; all are in mm, and radius is half the diameter"
            )

    @property
    def inner_radius(self) -> float:
        """Radius of the resin [mm]."""
        return self.radius - self.wall - self.gap - self.inner_wall

    @property
    def _layers(self) -> list[tuple[float, float, float]]:
        """(outer radius [mm], refractive index, absorption [1/mm]) of the layers around the resin, outermost first."""
        inner_index = self.wall_index if self.inner_wall_index is None else self.inner_wall_index
        inner_wall = self.radius - self.wall - self.gap
        layers = (
            (self.wall, (self.radius, self.wall_index, self.wall_absorption)),
            (self.gap, (self.radius - self.wall, self.liquid_index, self.liquid_absorption)),
            (self.inner_wall, (inner_wall, inner_index, self.wall_absorption)),
        )
        return [layer for thickness, layer in layers if thickness > 0]

    @property
    def faces(self) -> tuple[Face, ...]:
        """The refracting faces, from the outside in."""
        layers = [*self._layers, (self.inner_radius, self.resin_index, self.absorption)]
        outer = [self.bath_index, *(index for _, index, _ in layers)]
        return tuple(
            Face(radius, before, index, self.bath_index)
            for before, (radius, index, _) in zip(outer, layers, strict=False)
        )

    def transmitted(self, u: Floats) -> Floats:
        layers, depth = self._layers, np.zeros_like(u)
        ends = [*(radius for radius, _, _ in layers), self.inner_radius][1:]
        for (radius, index, absorption), end in zip(layers, ends, strict=True):
            if absorption > 0:
                p = u * (self.bath_index / index)
                depth += absorption * (_half_chord(radius, p) - _half_chord(end, p))
        return super().transmitted(u) * np.exp(-depth)


def _half_chord(radius: float, p: Floats) -> Floats:
    """Half the length [mm] of a chord at the distance p from the axis of a circle."""
    return np.sqrt(np.maximum((radius - p) * (radius + p), 0.0))

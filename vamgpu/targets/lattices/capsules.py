"""An endless array of closed shells that can enclose something."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vamgpu.errors import BadInput
from vamgpu.geometry import positive
from vamgpu.targets.implicit import Distance

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Capsules(Distance):
    """Hollow cylinders with round ends along x (l on a web), repeated along x and z about y = ``depth``.

    The first one is centered at x = half a spacing and z = 0.

    Args:
        radius: Radius of the outside [mm].
        length: Length of the straight part [mm].
        wall: Thickness of the wall [mm]; ``radius`` for solid capsules.
        spacing: Distance from one capsule to the next along x and z [mm].
        depth: Depth of their axes [mm].

    Raises:
        BadInput: A value is out of its range, or the capsules would touch.
    """

    radius: float = 0.8
    length: float = 0.8
    wall: float = 0.25
    spacing: tuple[float, float] = (3.2, 2.4)
    depth: float = 1.5

    def __post_init__(self) -> None:
        radius = positive("Capsules radius [mm]", self.radius)
        long = positive("Capsules length [mm]", self.length, zero=True) + 2.0 * radius
        if positive("Capsules wall [mm]", self.wall) > radius:
            raise BadInput(f"Capsules wall is {self.wall:g} mm; expected at most the radius of {radius:g} mm")
        if not np.isfinite(self.depth):
            raise BadInput(f"Capsules depth is {self.depth!r}; expected a finite length [mm]")
        if len(self.spacing) != 2 or not self.spacing[0] > long or not self.spacing[1] > 2.0 * radius:
            raise BadInput(
                f"Capsules spacing is {self.spacing!r} mm; expected more than ({long:g}, {2 * radius:g}) along x and "
                "z, or they touch"
            )

    def __call__(self, x: Array, y: Array, z: Array, /) -> Array:
        """Distance [mm], negative inside the wall."""
        along, across = self.spacing
        x = np.asarray(x, np.float64) / along - 0.5
        z = np.asarray(z, np.float64) / across
        beyond = np.maximum(along * np.abs(x - np.round(x)) - 0.5 * self.length, 0.0)
        skin = np.sqrt(beyond**2 + (y - self.depth) ** 2 + (across * (z - np.round(z))) ** 2) - self.radius
        return np.maximum(skin, -skin - self.wall) if self.wall < self.radius else skin

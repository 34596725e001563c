"""Rays bend between the faces of a film whose index changes from place to place."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.geometry import positive
from vamgpu.optics.inputs import Floats

NUDGE = 1e-4
"""Half the way [mm] over which a slope of the index is taken."""


@dataclass(frozen=True)
class FilmIndex:
    """Index of the resin at wrapped places, fixed in the laboratory as one pose needs it.

    index: (x, y) [mm], arrays → refractive indices, same shape; asked up to `NUDGE` outside the film too.  stride:
    longest straight piece [mm]; errors fall with its square.  Raises `BadInput`.
    """

    index: Callable[[Floats, Floats], Floats]
    stride: float = 0.05

    def __post_init__(self) -> None:
        object.__setattr__(self, "stride", positive("FilmIndex stride [mm]", self.stride))
        if not callable(self.index):
            raise BadInput(f"FilmIndex index is {self.index!r}; expected a function of x and y [mm]")

    def at(self, x: Floats, y: Floats) -> Floats:
        """Index at places; raises `BadInput` where it is below 1 or not finite."""
        found = np.broadcast_to(np.asarray(self.index(x, y), dtype=np.float64), x.shape)
        if not np.all(found >= 1.0) or not np.all(np.isfinite(found)):
            raise BadInput(
                f"the index of the resin is {np.min(found):g} to {np.max(found):g} along the rays; expected "
                "finite numbers of at least 1"
            )
        return found

    def slope(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Gradient [1/mm]."""
        east, north = self.at(x + NUDGE, y) - self.at(x - NUDGE, y), self.at(x, y + NUDGE) - self.at(x, y - NUDGE)
        return east / (2.0 * NUDGE), north / (2.0 * NUDGE)

    def kick(self, rays: dict[str, Any], way: Floats, strength: Floats) -> Floats:
        """Turn rays in the film by the slope at their place over a way [mm]; returns the new strength.

        strength: length of index × direction. Half a kick, a straight way and half a kick are one step of the
        second-order symplectic scheme for d(n·d)/ds = ∇n.
        """
        east, north = self.slope(rays["x"], rays["y"])
        pull = np.where(rays["film"], way, 0.0)
        px, py = strength * rays["dx"] + pull * east, strength * rays["dy"] + pull * north
        new = np.hypot(px, py)
        rays["dx"], rays["dy"] = px / new, py / new
        return new

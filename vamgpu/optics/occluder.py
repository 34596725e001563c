"""Obstacles in the light that do not rotate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from vamgpu.errors import BadInput
from vamgpu.geometry import Chords, Vessel
from vamgpu.optics.beams import Wrapper
from vamgpu.optics.inputs import Floats, as_offsets
from vamgpu.schema import check
from vamgpu.schema.quantities import Length, Place, Share


@dataclass(frozen=True)
class Occluded(Wrapper):
    """A rod parallel to the axis that stands in the light and does not rotate, and its shadow downstream.

    Args:
        vessel: Any vessel, including a `Fan`, or None for air.
        across: Position X of the rod across the light [mm].
        along: Position Y of the rod along the light [mm].
        radius: Radius of the rod [mm].
        transmittance: Share of the light that passes the rod.

    Raises:
        BadInput: A value is out of its range.
    """

    vessel: Vessel | None = None
    across: Place = 0.0
    along: Place = 0.0
    radius: Length = 1.0
    transmittance: Share = 0.0

    def __post_init__(self) -> None:
        if self.vessel is not None and not isinstance(self.vessel, Vessel):
            raise BadInput(f"Occluded got {self.vessel!r} as vessel; expected a vessel, or None for air")
        check(self)

    @property
    def is_round(self) -> bool:
        """Always False, because a rod stands on one side."""
        return False

    def chords(self, u: ArrayLike) -> Chords:
        return self.inner.chords(as_offsets("u", u))

    @property
    def bare(self) -> Vessel:
        """The vessel without the rod."""
        return self.inner

    def share(self, u: ArrayLike, across: ArrayLike, along: ArrayLike) -> Floats:
        """Share of the vessel's light that remains at some positions: the transmittance in the rod's shadow, else 1.

        Args:
            u: Columns of the light [mm], (...,).
            across: Position X across the light [mm], (...,).
            along: Position Y along the light [mm], (...,).

        Returns:
            Share of the light, (...,).
        """
        x, y = np.asarray(across), np.asarray(along)
        chords = self.inner.chords(np.asarray(u))
        cos_d, sin_d = np.cos(chords.angle), np.sin(chords.angle)
        beside = np.abs(self.across * cos_d + self.along * sin_d - chords.p)
        half = np.sqrt(np.maximum(self.radius**2 - beside**2, 0.0))
        beyond = (y - self.along) * cos_d - (x - self.across) * sin_d > -half
        return np.where((beside < self.radius) & beyond, self.transmittance, 1.0)

    def illuminate(self, across: ArrayLike, along: ArrayLike) -> tuple[Floats, Floats]:
        x, y = np.broadcast_arrays(as_offsets("across", across), as_offsets("along", along))
        u, weight = self.inner.illuminate(x, y)
        return u, weight * self.share(u, x, y)

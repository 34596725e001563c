"""Things that stand in the light, fixed in the laboratory."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from vamgpu.errors import BadInput
from vamgpu.geometry import Chords, Vessel
from vamgpu.operators.light import OpenAir
from vamgpu.optics.inputs import Floats, as_offsets
from vamgpu.schema import check
from vamgpu.schema.quantities import Length, Place, Share


@dataclass(frozen=True)
class Occluded:
    """A rod parallel to the axis that stands in the light, fixed in the laboratory, and its shadow downstream.

    Args:
        vessel: any vessel, a `Fan` too, or None for air.
        across, along: place of the rod in the laboratory [mm].
        radius: of the rod [mm].
        transmittance: share of the light that passes it.

    Raises:
        BadInput: a value is not finite, a radius not above 0, a transmittance beyond 0..1.
    """

    vessel: Vessel | None = None
    across: Place = 0.0
    along: Place = 0.0
    radius: Length = 1.0
    transmittance: Share = 0.0

    def __post_init__(self) -> None:
        if self.vessel is not None and not isinstance(self.vessel, Vessel):
            raise BadInput(f"Occluded got {self.vessel!r} as vessel; wanted a vessel, or None for air")
        check(self)

    @property
    def is_round(self) -> bool:
        """Never: a rod stands on one side."""
        return False

    @property
    def inner(self) -> Vessel:
        """The vessel, air included."""
        return OpenAir() if self.vessel is None else self.vessel

    @property
    def absorption(self) -> float:
        """Of the resin, natural logarithm [1/mm]."""
        return self.inner.absorption

    @property
    def lit_radius(self) -> float:
        """Radius that light would reach at every pose without the rod [mm]."""
        return self.inner.lit_radius

    def check_fits(self, radius: float) -> None:
        """What the vessel says about a target of this radius [mm]."""
        check = getattr(self.vessel, "check_fits", None)
        if check is not None:
            check(radius)

    def chords(self, u: ArrayLike) -> Chords:
        """Those of the vessel: the power that reaches the resin, before the rod."""
        return self.inner.chords(as_offsets("u", u))

    @property
    def bare(self) -> Vessel:
        """The vessel without the rod."""
        return self.inner

    def share(self, u: ArrayLike, across: ArrayLike, along: ArrayLike) -> Floats:
        """Of the vessel's light at u, what is left at a place: the transmittance in the rod's shadow, else 1."""
        x, y = np.asarray(across), np.asarray(along)
        chords = self.inner.chords(np.asarray(u))
        cos_d, sin_d = np.cos(chords.angle), np.sin(chords.angle)
        beside = np.abs(self.across * cos_d + self.along * sin_d - chords.p)
        half = np.sqrt(np.maximum(self.radius**2 - beside**2, 0.0))
        beyond = (y - self.along) * cos_d - (x - self.across) * sin_d > -half
        return np.where((beside < self.radius) & beyond, self.transmittance, 1.0)

    def illuminate(self, across: ArrayLike, along: ArrayLike) -> tuple[Floats, Floats]:
        """Column and weight of the vessel; in the rod and in its shadow the weight is cut to the transmittance."""
        x, y = np.broadcast_arrays(as_offsets("across", across), as_offsets("along", along))
        u, weight = self.inner.illuminate(x, y)
        return u, weight * self.share(u, x, y)

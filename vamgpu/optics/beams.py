"""Beams other than the collimated, centered one: each wraps a round vessel, or air, with another ray map.

They do not turn, so a map at one angle describes them: ``Projection(grid, beam, motion, Fan(vial, throw=300))``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from vamgpu.errors import BadInput
from vamgpu.geometry import Chords, Vessel
from vamgpu.operators.ray_table import OpenAir
from vamgpu.optics.inputs import Floats, as_offsets
from vamgpu.optics.vat import Vat
from vamgpu.schema import check
from vamgpu.schema.quantities import Far, Place, Turn

MOST_STEPS = 60
STEP_DONE = 1e-9
"""The search for a column ends at this change of the column, relative to the distance of the farthest point."""


class Wrapper(Vessel):
    """A vessel that changes the light of another vessel, or of air."""

    vessel: Vessel | None

    @property
    def inner(self) -> Vessel:
        """The wrapped vessel; air has one, too."""
        return OpenAir() if self.vessel is None else self.vessel

    @property
    def absorption(self) -> float:
        return self.inner.absorption

    @property
    def lit_radius(self) -> float:
        return self.inner.lit_radius

    def check_fits(self, radius: float) -> None:
        """Check a target of a radius [mm] against the wrapped vessel, if that has limits."""
        getattr(self.vessel, "check_fits", lambda radius: None)(radius)


@dataclass(frozen=True)
class Misaligned(Wrapper):
    """Parallel light that misses the axis of rotation.

    Args:
        vessel: A round vessel about the axis, or None for air.
        offset: Distance of the axis of rotation from the middle of the columns, towards +r [mm].
        tilt: Rotation of the light about the axis, in the plane [rad]: light travels towards -(cos, sin) of angle +
            tilt.

    Raises:
        BadInput: A value is not finite, or the vessel is not round.
    """

    vessel: Vessel | None = None
    offset: Place = 0.0
    tilt: Turn = 0.0

    def __post_init__(self) -> None:
        _check_round(self.vessel, type(self).__name__)
        check(self)

    @property
    def distance(self) -> float:
        """Distance of the projector's pupil from the axis [mm]; infinite for parallel light."""
        return inf

    def check_fits(self, radius: float) -> None:
        """Check a target against the vessel; in air, every target in front of the pupil fits.

        Args:
            radius: Radius of the target [mm].

        Raises:
            BadInput: The target reaches the pupil.
        """
        if radius >= self.distance:
            raise _too_short(self.distance, radius)
        super().check_fits(radius)

    def _entry(self, u: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Rays of columns u: distance q from the axis, turn d0, and the derivatives of both by u."""
        slope = u / self.distance
        root = np.sqrt(1.0 + slope**2)
        q, turn = (u - self.offset) / root, self.tilt - np.arctan(slope)
        q_by_u = 1.0 / root - (u - self.offset) * slope / self.distance / root**3
        return q, turn, q_by_u, -1.0 / (self.distance * root**2)

    def chords(self, u: ArrayLike) -> Chords:
        q, turn, q_by_u, turn_by_u = self._entry(as_offsets("u", u))
        straight = self.inner.chords(q)
        return Chords(
            straight.p,
            straight.angle + turn,
            straight.spread * q_by_u + turn_by_u,
            straight.transmittance,
            straight.length,
        )

    def illuminate(self, across: ArrayLike, along: ArrayLike) -> tuple[Floats, Floats]:
        # weights count columns in the plane: 1 / (magnification · cos of the ray's slope)
        x, y = np.broadcast_arrays(as_offsets("across", across), as_offsets("along", along))
        farthest = float(np.hypot(x, y).max(initial=0.0))
        if farthest >= self.distance:
            raise _too_short(self.distance, farthest)
        u, weight, moving = np.full(x.shape, self.offset), np.zeros(x.shape), np.zeros(x.shape, bool)
        for _ in range(MOST_STEPS):
            turn = self._entry(u)[1]
            q, weight = self.inner.illuminate(*turned(x, y, turn))
            # q = (u - offset) / sqrt(1 + (u / distance)^2), solved for u
            following = self.offset + q * np.sqrt(1.0 + (u / self.distance) ** 2)
            moving = (np.abs(following - u) > STEP_DONE * (1.0 + farthest)) & (self.distance < inf)
            u = following
            if not moving.any():
                break
        if (moving & (np.hypot(x, y) < (1.0 - 1e-9) * self.lit_radius)).any():
            raise BadInput(
                f"the pupil is {self.distance:g} mm from the axis, too near to follow its rays to every point within "
                f"{farthest:g} mm; expected a throw of several times that"
            )
        # where rays cross or none comes, beyond the lit radius, the search may never end
        return u, np.where(moving, 0.0, weight * self._denser(u, x, y))

    def _denser(self, u: Floats, x: Floats, y: Floats) -> Floats:
        """Density of columns relative to that of parallel light that enters along the same ray."""
        if self.distance == inf:
            return np.ones_like(u)
        q, turn, q_by_u, turn_by_u = self._entry(u)
        chord = self.inner.chords(q)
        step = 1e-3 * self.distance * 1e-3
        p_by_q = (self.inner.chords(q + step).p - self.inner.chords(q - step).p) / (2.0 * step)
        angle = chord.angle + turn
        t = y * np.cos(angle) - x * np.sin(angle)
        straight = p_by_q - t * chord.spread
        spread = p_by_q * q_by_u - t * (chord.spread * q_by_u + turn_by_u)
        return np.abs(straight) / np.maximum(np.abs(spread), 1e-2 * np.abs(straight) + 1e-30)


@dataclass(frozen=True)
class Fan(Misaligned):
    """Light that spreads in the plane from a pupil, for a lens that is not telecentric; rows stay level.

    Columns u are counted in the plane of the axis: in air, column u lights X = u (1 + Y / throw), and the irradiance
    falls as 1 / distance. If rows also spread, see `Cone`.

    Args:
        vessel: as for `Misaligned`.
        offset: as for `Misaligned` [mm].
        tilt: as for `Misaligned` [rad].
        throw: Distance of the pupil from the axis in the medium around the vessel [mm].

    Raises:
        BadInput: The throw is not above 0, or not longer than the vessel's radius.
    """

    throw: Far = inf

    def __post_init__(self) -> None:
        super().__post_init__()
        radius = getattr(self.vessel, "radius", None)
        if radius is not None and radius >= self.throw:
            raise _too_short(self.throw, radius)

    @property
    def distance(self) -> float:
        """The throw."""
        return self.throw


def turned(x: Floats, y: Floats, angle: Floats) -> tuple[Floats, Floats]:
    """(x, y) in a frame that is rotated by ``angle``."""
    c, s = np.cos(angle), np.sin(angle)
    return x * c + y * s, y * c - x * s


def _too_short(throw: float, reach: float) -> BadInput:
    return BadInput(
        f"the throw is {throw:g} mm, but the vessel or the volume reaches {reach:.4g} mm from the axis: "
        "the projector would stand inside it; expected a longer throw"
    )


def _check_round(vessel: Any, name: str) -> None:
    """Reject a vessel that is not rotationally symmetric."""
    if vessel is not None and not isinstance(vessel, Vessel):
        raise BadInput(f"{name} got {vessel!r} as vessel; expected a vessel, or None for air")
    if (
        isinstance(vessel, Misaligned)
        or not getattr(vessel, "is_round", True)
        or (isinstance(vessel, Vat) and vessel.radius is None)
    ):
        raise BadInput(
            f"{name} got {vessel!r}; expected a vessel that is round about the axis (a Vial, a Vat with a "
            "radius) or None: give offset and tilt to one wrapper, and wrap occluders last"
        )


def with_absorption(vessel: Any, absorption: float) -> Any:
    """Change the absorption [1/mm] of a vessel, or of the vessel inside its wrappers. Raises `BadInput`."""
    names = getattr(vessel, "__dataclass_fields__", {})
    if "absorption" in names:
        return replace(vessel, absorption=absorption)
    if "vessel" in names:
        return replace(vessel, vessel=with_absorption(vessel.vessel, absorption))
    raise BadInput(f"got {vessel!r}, whose absorption is not one number; expected a vessel that holds resin")

"""Beams whose light also moves along the axis of rotation: each consists of a plane, which is a vessel, and rows.

`Oblique` projects them, in air or a vat whose liquid matches: a round vial would bend rising light out of the plane.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import cos, sin
from typing import Any

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.geometry import Vessel
from vamgpu.operators.ray_table import OpenAir
from vamgpu.optics.beams import Fan, Misaligned, turned
from vamgpu.optics.inputs import Floats
from vamgpu.optics.vat import Vat
from vamgpu.schema.quantities import Length, Place, Turn, finite

STEEPEST = np.radians(80.0)  # elevation beyond which rays hardly cross the resin


@dataclass(frozen=True, init=False)
class Cone:
    """A fan whose rows spread like its columns: light comes from one pupil; the irradiance falls as 1/distance².

    The pupil is at the height of the middle row. The path of a row at the height w is longer by (w / throw)² / 2, which
    is ignored. ``plane`` is the `Fan`.

    Args:
        vessel: A `Vat` with a radius, or None for air.
        throw: Distance of the pupil from the axis [mm].
        offset: Distance of the axis of rotation from the middle of the columns, towards +r [mm].
        tilt: Rotation of the light about the axis, in the plane [rad].

    Raises:
        BadInput: As `Fan`, and for a vessel that bends light.
    """

    plane: Fan

    def __init__(self, vessel: Vessel | None = None, *, throw: Length, offset: Place = 0.0, tilt: Turn = 0.0) -> None:
        _check_straight(vessel, "Cone")
        object.__setattr__(self, "plane", Fan(vessel, offset, tilt, throw))

    def described(self) -> dict[str, Any]:
        """Describe the constructor's arguments.

        Returns:
            Its arguments by name.
        """
        return {name: getattr(self.plane, name) for name in ("vessel", "throw", "offset", "tilt")}

    def rows(self, across: Floats, along: Floats) -> tuple[Floats, Floats, Floats]:
        """Rows of the rays through some positions; see `vamgpu.operators.oblique.Rising`.

        Args:
            across: Position X across the light [mm], (...,).
            along: Position Y along the light [mm], (...,).

        Returns:
            Lift [mm], stretch and gain, (...,) each: the row of the ray through (X, Y, z) is lift + stretch·z.
        """
        downstream = turned(across, along, np.asarray(self.plane.tilt))[1]
        stretch = 1.0 / (1.0 + downstream / self.plane.throw)
        return np.zeros_like(stretch), stretch, stretch


@dataclass(frozen=True, init=False)
class Inclined:
    """Parallel light that rises towards +z at an angle ``elevation`` through the resin (laminography).

    Rows are counted across the light: the row z·cos ψ − Y·sin ψ lights a point. Rays in the resin are 1 / cos ψ times
    as long as in the plane, and absorbed accordingly.

    Args:
        vessel: A `Vat`, or None for air.
        elevation: Angle ψ in the resin [rad].
        offset: Distance of the axis of rotation from the middle of the columns, towards +r [mm].
        tilt: Rotation of the light about the axis, in the plane [rad].

    Raises:
        BadInput: The elevation exceeds 80 degrees, the vessel bends light, or as for `Misaligned`.
    """

    plane: Vessel
    elevation: float
    tilt: float

    def __init__(self, vessel: Vessel | None = None, *, elevation: Turn, offset: Place = 0.0, tilt: Turn = 0.0) -> None:
        _check_straight(vessel, "Inclined")
        if abs(finite("Inclined elevation [rad]", elevation)) > STEEPEST:
            raise BadInput(
                f"elevation is {np.degrees(elevation):.4g} degrees; expected at most "
                f"{np.degrees(STEEPEST):.0f} either way; give it in rad"
            )
        inner: Any = OpenAir() if vessel is None else vessel
        if isinstance(inner, Vat) and inner.absorption > 0:
            inner = replace(inner, absorption=inner.absorption / cos(elevation))
        plane = Misaligned(inner, offset, tilt) if offset or tilt else inner
        given = {"vessel": vessel, "elevation": float(elevation), "offset": float(offset), "tilt": float(tilt)}
        for name, value in (("plane", plane), ("elevation", elevation), ("tilt", tilt), ("_given", given)):
            object.__setattr__(self, name, value)

    def described(self) -> dict[str, Any]:
        """Return the constructor's arguments; the absorption stored in ``plane`` already includes the longer path.

        Returns:
            The arguments by name.
        """
        return self._given  # type: ignore[attr-defined]

    def rows(self, across: Floats, along: Floats) -> tuple[Floats, Floats, Floats]:
        """Rows of the rays through some positions; see `vamgpu.operators.oblique.Rising`.

        Args:
            across: Position X across the light [mm], (...,).
            along: Position Y along the light [mm], (...,).

        Returns:
            Lift [mm], stretch and gain, (...,) each: the row of the ray through (X, Y, z) is lift + stretch·z.
        """
        downstream = turned(across, along, np.asarray(self.tilt))[1]
        stretch = np.full_like(downstream, cos(self.elevation))
        return -sin(self.elevation) * downstream, stretch, stretch if self.plane.absorption else np.ones_like(stretch)


def _check_straight(vessel: Any, name: str) -> None:
    if vessel is not None and not isinstance(vessel, (Vat, OpenAir)):
        raise BadInput(
            f"{name} got {vessel!r}; expected a Vat, or None for air: a vessel that bends light in the plane also "
            "bends rising light out of it"
        )

"""Small errors of a machine, and the operators that expose the same frames with them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from vamgpu.errors import BadInput
from vamgpu.geometry import Beam
from vamgpu.operators.projection import Projection
from vamgpu.optics.beams import Misaligned, with_absorption


@dataclass(frozen=True)
class Scenario:
    """One kind of error."""

    name: str
    unit: str  # of the amounts: "pixel", or "%"
    amounts: tuple[float, ...]  # amounts in the table, in pixels or as a share
    farthest: float  # largest amount up to which the first wrong voxel is searched for
    # beam and vessel of a machine with an error of this amount; raises `BadInput` if the error does not apply. None if
    # only the dose is scaled
    off: Callable[[Projection, float], tuple[Beam, Any]] | None

    @property
    def signs(self) -> tuple[int, ...]:
        """Signs of the amounts: -1 if negative amounts exist, and 1."""
        return (-1, 1) if min(self.amounts) < 0 else (1,)

    def written(self, amount: float, digits: int = 3) -> str:
        """An amount with its sign and unit."""
        value = 100 * amount if self.unit == "%" else amount
        return f"{value:+.{digits}g} {self.unit}".replace("-", "−")


def _softer(A: Projection, pixels: float) -> tuple[Beam, Any]:
    """A lens whose point spread is wider by a number of pixels (added to σ)."""
    return replace(A.beam, spread=(A.beam.sigma + pixels) * A.beam.pitch), A.vessel


def _aside(A: Projection, pixels: float) -> tuple[Beam, Any]:
    return A.beam, _displaced(A.vessel, pixels * A.beam.pitch)


def displaced(A: Projection, pixels: float) -> Projection:
    """The axis of rotation, moved off the middle of the columns by a number of pixels towards +r. Raises `BadInput`."""
    return clouded_and_displaced(A, 0.0, pixels)


def clouded(A: Projection, share: float) -> Projection:
    """Resin that absorbs more or less than it should, by a share. Raises `BadInput` if the resin absorbs nothing."""
    return clouded_and_displaced(A, share, 0.0)


def clouded_and_displaced(A: Projection, share: float, pixels: float) -> Projection:
    """`clouded` and `displaced` with tables computed once; A itself for amounts of 0. Raises `BadInput` as they do."""
    vessel: Any = A.vessel
    if share:
        vessel = _clouded(vessel, share)
    if pixels:
        vessel = _displaced(vessel, pixels * A.beam.pitch)
    return A if vessel is A.vessel else _varied(A, A.beam, vessel)


def _clouded(vessel: Any, share: float) -> Any:
    if vessel is None or vessel.absorption == 0:
        raise BadInput("the light passes without absorption")
    return with_absorption(vessel, (1.0 + share) * vessel.absorption)


def _displaced(vessel: Any, offset: float) -> Misaligned:
    if isinstance(vessel, Misaligned):
        return replace(vessel, offset=vessel.offset + offset)
    try:
        return Misaligned(vessel, offset)
    except BadInput as error:
        raise BadInput(f"a {type(vessel).__name__} that is not centered on the axis differs at every angle") from error


def _varied(A: Projection, beam: Beam, vessel: Any) -> Projection:
    return Projection(A.grid, beam, A.motion, vessel, device=A.device)


SCENARIOS = (
    Scenario("point spread", "pixel", (0.25, 0.5, 1.0), 2.0, _softer),
    Scenario("axis of rotation", "pixel", (-0.5, -0.25, 0.25, 0.5), 2.0, _aside),
    Scenario("absorption", "%", (-0.1, 0.1), 0.5, lambda A, share: (A.beam, _clouded(A.vessel, share))),
    Scenario("dose", "%", (-0.1, -0.05, 0.05, 0.1), 1.0, None),
)
"""Scenarios of a report's tolerance table."""

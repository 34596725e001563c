"""What must hold while light is on; pure, so that it can be proven."""

from __future__ import annotations

from dataclasses import dataclass, replace

from vamgpu.errors import VamError
from vamgpu.geometry import positive


class InterlockOpen(VamError, RuntimeError):
    """Light was asked for while something that must hold for it does not."""


class OverDose(InterlockOpen):
    """The light has spent what the print was given."""


@dataclass(frozen=True)
class Seen:
    """What the host last saw of its machines.

    armed: schedule, frames and powers are loaded and a person or program said go.  lease: whether the controller's
    lease is fresh.  motion: distance of the stage or web from where it should be, in the unit of the tolerance; None
    before the first look.  shown, scheduled: the picture that stands, and the one that should.  fault: why a machine
    cannot be trusted; None where all can.
    """

    armed: bool = False
    lease: bool = False
    motion: float | None = None
    shown: int | None = None
    scheduled: int | None = None
    fault: str | None = None

    def change(self, **fields: object) -> Seen:
        """The same with some fields replaced."""
        return replace(self, **fields)  # type: ignore[arg-type]


def reason_dark(seen: Seen, tolerance: float) -> str | None:
    """Why light must be off; None where it may be on. tolerance: the greatest error of motion."""
    if seen.fault is not None:
        return seen.fault
    if not seen.armed:
        return "the print is not armed"
    if not seen.lease:
        return "the controller's lease is stale"
    if seen.motion is None:
        return "nobody has looked where the stage is"
    if not abs(seen.motion) <= tolerance:  # a NaN is no position either
        return f"the stage is {seen.motion:+.4g} from where it should be; {tolerance:.4g} is allowed"
    if seen.shown != seen.scheduled or seen.scheduled is None:
        return f"picture {seen.shown} stands where {seen.scheduled} is scheduled"
    return None


class Budget:
    """Light that a print may spend, in power × time that the light was really on.

    limit: [mW·s] or in whatever unit the powers have, times seconds. Whoever cannot say how long light was on, counts
    it as on since it was opened. Raises `BadInput`.
    """

    def __init__(self, limit: float) -> None:
        self.limit, self._spent = positive("the budget of light", limit), 0.0

    @property
    def spent(self) -> float:
        """What has been spent."""
        return self._spent

    @property
    def left(self) -> float:
        """What is left; never below 0."""
        return max(0.0, self.limit - self._spent)

    def allows(self, power: float, on_time: int) -> bool:
        """Whether a picture of ``on_time`` [ns] at ``power`` still fits; a millionth more is rounding."""
        return self._spent + _light(power, on_time) <= self.limit * (1.0 + 1e-6)

    def spend(self, power: float, on_time: int) -> None:
        """Count a picture. Raises `OverDose` where it did not fit; it is counted all the same.

        What is no power or time, a negative one for instance, is refused: nothing gives light back. Raises `BadInput`.
        """
        fits = self.allows(power, on_time)
        self._spent += _light(power, on_time)
        if not fits:
            raise OverDose(
                f"the light has spent {self._spent:.6g} of {self.limit:.6g}; the plan wants no more: "
                "look at the powers and on-times of the schedule"
            )


def _light(power: float, on_time: int) -> float:
    """Power × seconds."""
    return positive("power", power, zero=True) * positive("on_time [ns]", on_time, zero=True) * 1e-9

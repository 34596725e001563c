"""What must hold while light is on: the state of the machines, a budget of light, and a lease that must be renewed."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from vamgpu.errors import BadInput, VamError
from vamgpu.geometry import positive
from vamgpu.hosts.schedules.timing import whole


class InterlockOpen(VamError, RuntimeError):
    """Light was asked for while something that must hold for it does not."""


class OverDose(InterlockOpen):
    """The light has spent what the print was given."""


@dataclass(frozen=True)
class Observation:
    """What the host last saw of its machines.

    armed: schedule, frames and powers are loaded and a person or program said go.  lease: whether the controller's
    lease is fresh.  motion: distance of the stage or web from where it should be, in the unit of the tolerance; None
    before the first poll.  shown, scheduled: the frame on show, and the scheduled one.  fault: why a machine
    cannot be trusted; None where all can.
    """

    armed: bool = False
    lease: bool = False
    motion: float | None = None
    shown: int | None = None
    scheduled: int | None = None
    fault: str | None = None

    def change(self, **fields: object) -> Observation:
        """The same with some fields replaced."""
        return Observation(**(vars(self) | fields))  # type: ignore[arg-type]


def reason_dark(seen: Observation, tolerance: float) -> str | None:
    """Why light must be off; None where it may be on. tolerance: the greatest error of motion."""
    if seen.fault is not None:
        return seen.fault
    if not seen.armed:
        return "the print is not armed"
    if not seen.lease:
        return "the controller's lease is stale"
    if seen.motion is None:
        return "nobody has asked where the stage is"
    if not abs(seen.motion) <= tolerance:  # a NaN is no position either
        return f"the stage is {seen.motion:+.4g} from where it should be; {tolerance:.4g} is allowed"
    if seen.shown != seen.scheduled or seen.scheduled is None:
        return f"frame {seen.shown} is on show; expected frame {seen.scheduled}"
    return None


class Budget:
    """Light that a print may spend, in power × time that the light was really on.

    limit: [mW·s] or in whatever unit the powers have, times seconds. Whoever cannot say how long light was on, counts
    it as on since it was opened. Raises `BadInput`.
    """

    limit: float

    def __init__(self, limit: float) -> None:
        self.limit, self._spent = positive("the budget of light", limit), 0.0
        self._most = self.limit

    @property
    def spent(self) -> float:
        """What has been spent."""
        return self._spent

    @property
    def left(self) -> float:
        """What is left; never below 0."""
        return max(0.0, self.limit - self._spent)

    def arm(self, limit: float) -> None:
        """Set another limit, for light that is planned anew: at most what was given first. Raises `BadInput`."""
        self.limit = min(positive("the budget of light", limit), self._most)

    def allows(self, power: float, on_time: int) -> bool:
        """Whether a frame of ``on_time`` [ns] at ``power`` still fits; a millionth more is rounding."""
        return self._spent + _light(power, on_time) <= self.limit * (1.0 + 1e-6)

    def spend(self, power: float, on_time: int) -> None:
        """Count a frame. Raises `OverDose` where it did not fit; it is counted all the same.

        What is no power or time, a negative one for instance, is refused: nothing gives light back. Raises `BadInput`.
        """
        fits = self.allows(power, on_time)
        self._spent += _light(power, on_time)
        if not fits:
            raise OverDose(
                f"the light has spent {self._spent:.6g} of {self.limit:.6g}; expected no more than the plan: "
                "look at the powers and on-times of the schedule"
            )


def _light(power: float, on_time: int) -> float:
    """Power × seconds."""
    return positive("power", power, zero=True) * positive("on_time [ns]", on_time, zero=True) * 1e-9


DEFAULT_LENGTH = 250_000_000  # how long a controller keeps the light without being told to [ns]

SHORTEST = 10_000_000  # least length of a lease [ns]


class Time(Protocol):
    """A clock as the lease sees it."""

    def now(self) -> int: ...  # the time [ns]


class Lease:
    """What a host must renew. It is renewed for work done, never for mere time passed.

    renew: tells the controller to keep the light for ``length`` [ns] more; raises what its line raises. stall: how old
    the last sign of work may be [ns]; by default as long as the lease. A host whose GPU, disk or upload hangs stops
    giving signs, so that a renewing thread that still lives does not keep the light of a print that does not. Raises
    `BadInput`.
    """

    def __init__(
        self,
        clock: Time,
        renew: Callable[[int], None],
        length: int = DEFAULT_LENGTH,
        stall: int | None = None,
    ) -> None:
        self.length: int = whole("the lease [ns]", length)
        if self.length < SHORTEST:
            raise BadInput(f"a lease of {length} ns; expected 10 ms or more, which a line and a scheduler can hold")
        self.stall: int = self.length if stall is None else whole("stall [ns]", stall)
        self._clock, self._renew = clock, renew
        self._lock = threading.Lock()
        self._until: int | None = None
        self._sign: int | None = None
        self._revoked = False

    def begin(self) -> None:
        """Take the lease, with a sign of work now."""
        with self._lock:
            self._revoked = False
            self._sign = self._clock.now()
        self.keep(force=True)

    def beat(self) -> None:
        """Give a sign of work."""
        self._sign = self._clock.now()

    def keep(self, force: bool = False) -> bool:
        """Renew where a quarter of the lease has passed and there was work; whether the controller was told."""
        with self._lock:
            now = self._clock.now()
            if self._revoked or self._sign is None or now - self._sign > self.stall:
                return False
            if not force and self._until is not None and self._until - now > 3 * self.length // 4:
                return False
            self._renew(self.length)
            # Counted from before the message left: the controller counts from its arrival, which is later.
            self._until = now + self.length
            return True

    def fresh(self, now: int | None = None) -> bool:
        """Whether the controller still keeps the light, as far as the host can know."""
        until = self._until
        at = self._clock.now() if now is None else now
        return not self._revoked and until is not None and at < until

    def age(self) -> int | None:
        """How long ago it was renewed [ns]; None while it is not held."""
        until = self._until
        return None if until is None else self._clock.now() - (until - self.length)

    def revoke(self) -> None:
        """Never renew again; needs no line and cannot fail."""
        self._revoked = True
        self._until = None

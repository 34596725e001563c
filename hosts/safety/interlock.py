"""Conditions for light: the state of the machines, a budget of light, and a lease that must be renewed."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass

from vamgpu.errors import BadInput, VamError
from vamgpu.geometry import positive
from vamgpu.hosts.schedules.clock import Clock
from vamgpu.hosts.schedules.timing import whole


class InterlockOpen(VamError, RuntimeError):
    """Light was requested while one of its conditions did not hold."""


class OverDose(InterlockOpen):
    """The light has used up the print's budget."""


@dataclass(frozen=True)
class Observation:
    """The host's last observation of its machines."""

    armed: bool = False  # everything is loaded, and a user or program has started the print
    lease: bool = False  # whether the controller's lease is current
    motion: float | None = None  # position error; None before the first poll
    shown: int | None = None  # frame
    scheduled: int | None = None  # frame
    fault: str | None = None  # why a machine is not reliable


def reason_dark(seen: Observation, tolerance: float) -> str | None:
    """Reason why light must be off; None if it may be on. tolerance: the greatest error of motion."""
    if seen.fault is not None:
        return seen.fault
    if not seen.armed:
        return "the print is not armed"
    if not seen.lease:
        return "the controller's lease is stale"
    if seen.motion is None:
        return "the stage's position has not been read"
    if not abs(seen.motion) <= tolerance:  # also if it is NaN
        return f"the stage is off position by {seen.motion:+.4g}; {tolerance:.4g} is allowed"
    if seen.shown != seen.scheduled or seen.scheduled is None:
        return f"frame {seen.shown} is shown; expected frame {seen.scheduled}"
    return None


class Budget:
    """Light that a print may use: power × seconds of light, in the unit of its limit."""

    limit: float

    def __init__(self, limit: float) -> None:
        self.limit = self._most = positive("the budget of light", limit)
        self.spent: float = 0.0  # light used so far

    def arm(self, limit: float) -> None:
        """Set another limit for a replanned print, at most the first limit. Raises `BadInput`."""
        self.limit = min(positive("the budget of light", limit), self._most)

    def allows(self, power: float, on_time: int) -> bool:
        """Whether a frame of ``on_time`` [ns] at ``power`` still fits; a millionth more counts as rounding."""
        return self.spent + _light(power, on_time) <= self.limit * (1.0 + 1e-6)

    def spend(self, power: float, on_time: int) -> None:
        """Count a frame; OverDose if it does not fit, and it still counts. Used light is never returned."""
        fits = self.allows(power, on_time)
        self.spent += _light(power, on_time)
        if not fits:
            raise OverDose(self.excess)

    @property
    def excess(self) -> str:
        """Text of the error if more than the limit is used; empty otherwise."""
        if self.allows(0.0, 0):
            return ""
        return (
            f"the print has used {self.spent:.6g} of {self.limit:.6g} of light; expected no more than the plan: "
            "check the powers and on-times of the schedule"
        )


def _light(power: float, on_time: int) -> float:
    """Power × seconds."""
    return positive("power", power, zero=True) * positive("on_time [ns]", on_time, zero=True) * 1e-9


DEFAULT_LENGTH = 250_000_000  # time for which a controller keeps the light on without renewal [ns]
SHORTEST = 10_000_000  # least length of a lease [ns]


class Lease:
    """A lease [ns] that is renewed when work was done, never by elapsed time alone."""

    # A host whose GPU, disk or upload hangs shows no work for longer than the lease: its light goes off, even if other
    # threads still run.

    def __init__(self, clock: Clock, renew: Callable[[int], None], length: int = DEFAULT_LENGTH) -> None:
        self.length: int = whole("the lease [ns]", length)
        if self.length < SHORTEST:
            raise BadInput(f"a lease of {length} ns; expected 10 ms or more, which a line and a scheduler can keep")
        self._clock, self._renew = clock, renew
        self._lock = threading.Lock()
        self._until: int | None = None
        self._sign: int | None = None
        self._revoked = False

    def begin(self) -> None:
        """Take the lease; this counts as work."""
        with self._lock:
            self._revoked = False
            self._sign = self._clock.now()
        self.keep(force=True)

    def beat(self) -> None:
        self._sign = self._clock.now()

    def keep(self, force: bool = False) -> bool:
        """Renew if a quarter of the lease has passed and there was work; whether it was renewed."""
        with self._lock:
            now = self._clock.now()
            if self._revoked or self._sign is None or now - self._sign > self.length:
                return False
            if not force and self._until is not None and self._until - now > 3 * self.length // 4:
                return False
            self._renew(self.length)
            # counted from before the message is sent: the controller counts from its arrival, which is later
            self._until = now + self.length
            return True

    def fresh(self) -> bool:
        """Whether the controller still keeps the light on, to the host's knowledge."""
        until = self._until
        return not self._revoked and until is not None and self._clock.now() < until

    def age(self) -> int | None:
        """Age of the last renewal [ns]; None if the lease is not held."""
        until = self._until
        return None if until is None else self._clock.now() - (until - self.length)

    def revoke(self) -> None:
        """Stop renewing for good; needs no line and cannot fail."""
        self._revoked = True
        self._until = None

"""Conditions of light: the state of the machines, a budget of light, and a lease that must be renewed."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass

from vamgpu.errors import BadInput, VamError
from vamgpu.geometry import positive
from vamgpu.hosts.schedules.clock import Clock
from vamgpu.hosts.schedules.timing import whole


class InterlockOpen(VamError, RuntimeError):
    """Light was asked for while something that must hold for it does not."""


class OverDose(InterlockOpen):
    """The light has spent what the print was given."""


@dataclass(frozen=True)
class Observation:
    """The host's last observation of its machines."""

    armed: bool = False  # all is loaded, and a person or program said go
    lease: bool = False  # the controller's is fresh
    motion: float | None = None  # from where it should be; None before the first poll
    shown: int | None = None  # frame
    scheduled: int | None = None  # frame
    fault: str | None = None  # why a machine cannot be trusted


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
    """Light that a print may spend: power × seconds that the light was on, in the unit of its limit."""

    limit: float

    def __init__(self, limit: float) -> None:
        self.limit, self._spent = positive("the budget of light", limit), 0.0
        self._most = self.limit

    @property
    def spent(self) -> float:
        """Light that has been spent."""
        return self._spent

    def arm(self, limit: float) -> None:
        """Set another limit, for light that is planned anew: at most what was given first. Raises `BadInput`."""
        self.limit = min(positive("the budget of light", limit), self._most)

    def allows(self, power: float, on_time: int) -> bool:
        """Whether a frame of ``on_time`` [ns] at ``power`` still fits; a millionth more is rounding."""
        return self._spent + _light(power, on_time) <= self.limit * (1.0 + 1e-6)

    def spend(self, power: float, on_time: int) -> None:
        """Count a frame; OverDose where it did not fit, which counts all the same. Nothing gives light back."""
        fits = self.allows(power, on_time)
        self._spent += _light(power, on_time)
        if not fits:
            raise OverDose(
                f"the light has spent {self._spent:.6g} of {self.limit:.6g}; expected no more than the plan: "
                "check the powers and on-times of the schedule"
            )


def _light(power: float, on_time: int) -> float:
    """Power × seconds."""
    return positive("power", power, zero=True) * positive("on_time [ns]", on_time, zero=True) * 1e-9


DEFAULT_LENGTH = 250_000_000  # how long a controller keeps the light without a renewal [ns]

SHORTEST = 10_000_000  # least length of a lease [ns]


class Lease:
    """A lease [ns] that is renewed for signs of work, never for mere time passed."""

    # A host whose GPU, disk or upload hangs gives no signs for longer than ``stall`` [ns]: its light goes off, whatever
    # threads still live.

    def __init__(
        self, clock: Clock, renew: Callable[[int], None], length: int = DEFAULT_LENGTH, stall: int | None = None,
    ) -> None:  # fmt: skip
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
        """Renew where a quarter of the lease has passed and there was work; whether it was renewed."""
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
        """Age of the last renewal [ns]; None while the lease is not held."""
        until = self._until
        return None if until is None else self._clock.now() - (until - self.length)

    def revoke(self) -> None:
        """Never renew again; needs no line and cannot fail."""
        self._revoked = True
        self._until = None

"""Time as hosts see it: whole nanoseconds since some start, from the machine or from a program."""

from __future__ import annotations

import time
from functools import partial
from typing import Protocol, runtime_checkable

SHORT = 200_000
"""The last stretch before a wake-up that is not slept through but watched [ns]; a sleep overshoots by about 60 µs."""


_now = partial(time.clock_gettime_ns, time.CLOCK_BOOTTIME) if hasattr(time, "CLOCK_BOOTTIME") else time.monotonic_ns


@runtime_checkable
class Clock(Protocol):
    """What tells the time and waits; nothing else in this package does either.

    real: whether it goes on by itself, so that threads must work ahead of it.
    """

    real: bool

    def now(self) -> int:
        """The time [ns]; it never goes back."""
        ...

    def sleep_until(self, until: int) -> None:
        """Return at ``until`` [ns] or soon after it; at once where that is past."""
        ...


class RealClock:
    """The machine's own monotonic clock, which goes on while a suspended machine sleeps, where its system tells.

    watch: how long before a wake-up [ns] to stop sleeping and watch the clock instead, which costs a core meanwhile; 0,
    the default, never does.  `SHORT` is enough to be on time.
    """

    real = True

    def __init__(self, watch: int = 0) -> None:
        self.watch = int(watch)

    def now(self) -> int:
        """The time [ns] since the machine started."""
        return _now()

    def sleep_until(self, until: int) -> None:
        """Sleep to ``until`` [ns]; returns late by what the system takes to wake a thread."""
        left = until - self.watch - _now()
        if left > 0:
            time.sleep(left * 1e-9)
        while self.watch and _now() < until:
            pass

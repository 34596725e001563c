"""Time of hosts: whole nanoseconds since some start, real or simulated."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Generic, Protocol, TypeVar, runtime_checkable

from vamgpu.hosts.schedules.timing import SECOND

_now = partial(time.clock_gettime_ns, time.CLOCK_BOOTTIME) if hasattr(time, "CLOCK_BOOTTIME") else time.monotonic_ns


@runtime_checkable
class Clock(Protocol):
    """A clock with sleep. real: it advances by itself, and threads must work ahead of it."""

    real: bool

    def now(self) -> int: ...  # the time [ns], never decreasing
    # return at ``until`` [ns] or soon after; at once if it is past
    def sleep_until(self, until: int) -> None: ...


class RealClock:
    """The machine's monotonic clock, which counts suspended time if the system supports it."""

    real = True

    def now(self) -> int:
        """The time [ns] since the machine started."""
        return _now()

    def sleep_until(self, until: int) -> None:
        """Sleep to ``until`` [ns]; returns late by the system's wake-up time."""
        if (left := until - _now()) > 0:
            time.sleep(left * 1e-9)


TRIES = 4  # number of tries for a query that took long
Answer = TypeVar("Answer")


class TimedQuery(Generic[Answer]):
    """A query, and the time halfway to its answer. slack: time that an answer may always take [ns]."""

    def __init__(self, clock: Clock, ask: Callable[[], Answer], slack: float) -> None:
        self._clock, self._ask, self._slack, self._quickest = clock, ask, slack, SECOND

    def __call__(self) -> tuple[int, Answer]:
        """Time [ns] and answer."""
        for _ in range(TRIES - 1):
            asked, answer, took = self._exchange()
            if took <= max(2 * self._quickest, self._slack):
                return asked + took // 2, answer
        asked, answer, took = self._exchange()
        return asked + took // 2, answer

    def _exchange(self) -> tuple[int, Answer, int]:
        """Time of the query [ns], the answer, and its duration [ns]."""
        asked = self._clock.now()
        answer = self._ask()
        took = self._clock.now() - asked
        self._quickest = min(self._quickest, took)
        return asked, answer, took

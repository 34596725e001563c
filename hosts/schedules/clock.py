"""Time as hosts see it: whole nanoseconds since some start, from the machine or from a program."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Generic, Protocol, TypeVar, runtime_checkable

from vamgpu.hosts.schedules.timing import SECOND

_now = partial(time.clock_gettime_ns, time.CLOCK_BOOTTIME) if hasattr(time, "CLOCK_BOOTTIME") else time.monotonic_ns


@runtime_checkable
class Clock(Protocol):
    """Tells the time and waits. real: it goes on by itself, so that threads must work ahead of it."""

    real: bool

    def now(self) -> int: ...  # the time [ns]; it never goes back
    # return at ``until`` [ns] or soon after it; at once where that is past
    def sleep_until(self, until: int) -> None: ...


class RealClock:
    """The machine's own monotonic clock, which goes on while a suspended machine sleeps, where its system tells."""

    real = True

    def now(self) -> int:
        """The time [ns] since the machine started."""
        return _now()

    def sleep_until(self, until: int) -> None:
        """Sleep to ``until`` [ns]; returns late by what the system takes to wake a thread."""
        if (left := until - _now()) > 0:
            time.sleep(left * 1e-9)


TRIES = 4  # how often a question that took long is asked
Answer = TypeVar("Answer")


class TimedQuery(Generic[Answer]):
    """A question, and the time halfway to its answer. slack: how long an answer may always take [ns]."""

    def __init__(self, clock: Clock, ask: Callable[[], Answer], slack: float) -> None:
        self._clock, self._ask, self._slack, self._quickest = clock, ask, slack, SECOND

    def __call__(self) -> tuple[int, Answer]:
        """When [ns], and what."""
        for _ in range(TRIES - 1):
            asked, answer, took = self._exchange()
            if took <= max(2 * self._quickest, self._slack):
                return asked + took // 2, answer
        asked, answer, took = self._exchange()
        return asked + took // 2, answer

    def _exchange(self) -> tuple[int, Answer, int]:
        """When it was asked [ns], the answer, and how long that took [ns]."""
        asked = self._clock.now()
        answer = self._ask()
        took = self._clock.now() - asked
        self._quickest = min(self._quickest, took)
        return asked, answer, took

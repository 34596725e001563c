"""Time as hosts see it: whole nanoseconds since some start, from the machine or from a program."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Generic, Protocol, TypeVar, runtime_checkable

from vamgpu.hosts.schedules.timing import SECOND

SHORT = 200_000
"""The last stretch before a wake-up that is not slept through but watched [ns]; a sleep overshoots by about 60 µs."""


_now = partial(time.clock_gettime_ns, time.CLOCK_BOOTTIME) if hasattr(time, "CLOCK_BOOTTIME") else time.monotonic_ns


@runtime_checkable
class Clock(Protocol):
    """What tells the time and waits; nothing else in this package does either.

    real: whether it goes on by itself, so that threads must work ahead of it.
    """

    real: bool

    def now(self) -> int: ...  # the time [ns]; it never goes back
    # return at ``until`` [ns] or soon after it; at once where that is past
    def sleep_until(self, until: int) -> None: ...


class RealClock:
    """The machine's own monotonic clock, which goes on while a suspended machine sleeps, where its system tells.

    watch: how long before a wake-up [ns] to stop sleeping and watch the clock instead, which costs a core meanwhile; 0,
    the default, never does.  `SHORT` is enough to be on time.
    """

    real = True

    def __init__(self, watch: int = 0) -> None:
        self.watch: int = int(watch)

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


TRIES = 4  # how often a question that took long is asked
Answer = TypeVar("Answer")


class TimedQuery(Generic[Answer]):
    """A question, and the time in the middle between it and its answer.

    slack: how long an answer may take [ns], if it does not take twice as long as the quickest so far.
    """

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

"""When a machine said something: a host that is held up between question and answer cannot tell, so it asks again."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, TypeVar

from vamgpu.hosts.clock import Clock
from vamgpu.hosts.schedules.timing import SECOND

TRIES = 4
"""How often a question that took long is asked."""
Answer = TypeVar("Answer")


class Asking(Generic[Answer]):
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

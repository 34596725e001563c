"""Time that a program sets: an hour's print runs in seconds, and twice the same."""

from __future__ import annotations

import threading
from typing import Protocol, runtime_checkable


@runtime_checkable
class Timed(Protocol):
    """An emulated machine whose state changes by itself."""

    def due(self) -> int | None:
        """When something happens next [ns]; None while nothing is pending."""
        ...

    def advance(self, now: int) -> None:
        """Carry the state to ``now`` [ns]; never called with a time before an earlier one's."""
        ...


class VirtualClock:
    """A clock that stands until somebody sleeps on it, and then jumps.

    While it jumps, attached machines act in order of time, those attached first first, so a run is exactly
    repeatable. Any thread may sleep: time then passes for everybody, as far as the sleeper asked. ``lock`` guards all
    that is attached: whoever reaches a machine by another way than the clock must hold it.
    """

    def __init__(self, start: int = 0) -> None:
        self._now = int(start)
        self._machines: list[Timed] = []
        self.lock = threading.RLock()

    def now(self) -> int:
        """The time [ns]."""
        return self._now

    def attach(self, machine: Timed) -> None:
        """Let a machine act when it is due."""
        with self.lock:
            self._machines.append(machine)

    def detach(self, machine: Timed) -> None:
        """Let a machine act no more."""
        with self.lock:
            self._machines = [each for each in self._machines if each is not machine]

    def sleep_until(self, until: int) -> None:
        """Jump to ``until`` [ns], through everything due before; a time that is past returns at once."""
        with self.lock:
            while True:
                pending = [(due, machine) for machine in self._machines if (due := machine.due()) is not None]
                if not pending:
                    break
                due, machine = min(pending, key=lambda entry: entry[0])
                if due > until:
                    break
                self._now = max(self._now, due)
                machine.advance(self._now)
            self._now = max(self._now, int(until))

    def sleep(self, duration: int) -> None:
        """Jump ahead by a duration [ns]."""
        self.sleep_until(self._now + int(duration))

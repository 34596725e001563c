"""Simulated time: an hour's print runs in seconds, and repeats exactly."""

from __future__ import annotations

import threading
from typing import Protocol, runtime_checkable

from vamgpu.hosts.schedules.clock import RealClock


@runtime_checkable
class Timed(Protocol):
    """An emulated machine whose state changes with time."""

    def due(self) -> int | None: ...  # time of its next event [ns]; None if there is none
    # advance the state to ``now`` [ns]; times of calls never decrease
    def advance(self, now: int) -> None: ...


class VirtualClock:
    """A clock that jumps ahead on sleep; attached machines act in order of time, under ``lock``."""

    real = False

    def __init__(self) -> None:
        self._now = 0
        self._machines: list[Timed] = []
        self.lock: threading.RLock = threading.RLock()

    def now(self) -> int:
        """The time [ns]."""
        return self._now

    def attach(self, machine: Timed) -> None:
        """Attach a machine, which acts when it is due."""
        with self.lock:
            self._machines.append(machine)

    def detach(self, machine: Timed) -> None:
        with self.lock:
            self._machines = [each for each in self._machines if each is not machine]

    def sleep_until(self, until: int) -> None:
        """Jump to ``until`` [ns], through everything due before; returns at once for a past time."""
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
        self.sleep_until(self.now() + int(duration))


class PacedClock(VirtualClock):
    """A virtual clock that keeps pace with real time, for viewers and for threads."""

    real = True

    def __init__(self) -> None:
        super().__init__()
        self._own, self._jumping = RealClock(), False
        self._began = self._own.now()

    def now(self) -> int:
        """The time [ns]; everything due by then has happened."""
        with self.lock:
            if not self._jumping:
                self._jumping = True
                try:
                    super().sleep_until(self._own.now() - self._began)
                finally:
                    self._jumping = False
            return self._now

    def sleep_until(self, until: int) -> None:
        """Return at ``until`` [ns] or soon after, when all machines that are due by then have acted."""
        self._own.sleep_until(self._began + until)
        self.now()

"""Machines that no status poll reads, such as a lens: asked during a print, with the slots for which they vouch."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from vamgpu.errors import DeviceError
from vamgpu.hosts.schedules.clock import Clock
from vamgpu.hosts.schedules.schedule import NONE, Schedule
from vamgpu.hosts.schedules.timing import SECOND

PERIOD = SECOND // 2  # between two questions [ns]
LAG = PERIOD // 4  # time of unconfirmed frames after which a machine is asked at each poll [ns]
SLACK = SECOND // 100  # error of the times of polls and answers [ns]
STEP = 0.005  # of focal powers [1/m]


class MachineWatch:
    """Asks machines. A lens at rest may be right by chance: it vouches only for frames that need its power."""

    vouched: int  # slot before which all machines did their work

    def __init__(self, ask: Callable[[], Mapping[str, object]], clock: Clock) -> None:
        self._ask, self._clock = ask, clock
        self._first = self._due = self._slot = self._before = self._seen = self._slot_asked = self.vouched = 0
        self._power: float | None = None
        self.silent: bool = False  # whether one of them did not

    def begin(self, first: int) -> Mapping[str, object]:
        """Ask in the dark, before a slot, when a lens may be at any power."""
        told = self._asked()
        self._first = self.vouched = self._slot_asked = first
        self._power = None
        return self._done(told)

    def due(self, slot: int, schedule: Schedule, seen: int, end: int) -> bool:
        """Whether to ask now: now and then, until all vouch, and before the slot ``end``. seen: time of a poll [ns]."""
        if slot != self._slot:
            self._slot, self._before = slot, self._seen
        self._seen = seen
        return self._clock.now() >= self._due or (end - slot) * schedule.gap < PERIOD

    def ask(self, slot: int, schedule: Schedule, over: bool = False) -> Mapping[str, object]:
        """Ask at a slot. over: the light is off after its frames."""
        told = self._asked()
        power = told.get("focus")
        if slot <= self._first or not isinstance(power, float) or np.isnan(schedule.focus[slot - 1]):
            self.vouched = self.vouched if over else slot  # a lamp that is off no longer reports its light
            return self._done(told)
        window = int(schedule.light[slot - 1]) + self._clock.now() - self._before + SLACK
        coming = np.flatnonzero((schedule.command != NONE) & (schedule.command <= window))
        near = {slot - 1} if over else {slot - 1, *coming[coming >= slot].tolist()}
        possible = schedule.focus[sorted(near)]
        if not np.any(np.abs(possible - power) <= STEP):
            wanted = ", ".join(f"{each:.3f}" for each in sorted(set(possible.tolist())))
            raise DeviceError(f"the lens is at {power:.3f} dpt; expected {wanted}: check the line that sets it")
        last = max(near) + 1
        if (np.abs(schedule.focus[self.vouched : last] - power) <= STEP).all():
            self.vouched = slot  # these frames need one power
        elif self._power is not None and abs(power - self._power) > STEP:
            start = max(self._slot_asked - 1, 0)  # it has moved since the last answer
            reached = start + int(np.argmax(np.abs(schedule.focus[start:last] - power) <= STEP))
            self.vouched = min(max(self.vouched, reached + 1), slot)
        self._power, self._slot_asked = power, slot
        return self._done(told, again=(slot - self.vouched) * schedule.gap > LAG)

    def _asked(self) -> Mapping[str, object]:
        self.silent = True
        return self._ask()

    def _done(self, told: Mapping[str, object], again: bool = False) -> Mapping[str, object]:
        self.silent = False
        self._due = self._clock.now() + (0 if again else PERIOD)
        return told

"""The stage of a vial, counted in slots of a video cable: brought to its speed and into step with it, then watched.

A reading of the angle tells which slot the refresh before it began. The clock does no more than carry the reading back
to that refresh, by less than a video frame: what is shown follows from where the stage is.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from math import ceil

from vamgpu.hosts.clock import Clock
from vamgpu.hosts.drivers.stage import Stage
from vamgpu.hosts.players.asking import Asking
from vamgpu.hosts.safety.interlock import InterlockOpen
from vamgpu.hosts.schedules.limits import HdmiTiming
from vamgpu.hosts.schedules.schedule import Schedule
from vamgpu.hosts.schedules.timing import SECOND

log = logging.getLogger(__name__)
SPIN_UP = 10 * SECOND
"""Longest wait for the stage to have its speed [ns]."""
SETTLED = SECOND // 4
"""For how long it must have kept it [ns]."""
WINDOW = SECOND
"""Over which its speed is judged in a print [ns]."""
EVEN = 0.05
"""Greatest error at its speed [poses]."""
LEAD = 0.25
"""How long before its first picture a stage is ready for light [s]."""
NUDGE = 15
"""Video frames in which the stage is brought into step with the cable."""
TRIES = 4
"""How often that is tried."""
STEP = 0.02
"""Greatest distance from being in step [slots]."""


@dataclass(frozen=True)
class Reading:
    """What the stage said. degrees: since pose 0.  slots: of the cable since pose 0, at the last refresh.

    since: refreshes after the one that was seen.  error: how far it went astray within the last second [poses].
    """

    degrees: float
    slots: float
    since: int
    error: float


class Turning:
    """The stage of one print, which turns forward only. Pose 0 is at the stage's own zero, so every leg meets it.

    repeats: slots of the cable in a pose.
    """

    def __init__(self, stage: Stage, clock: Clock, schedule: Schedule, display: HdmiTiming, repeats: int) -> None:
        self._stage, self._clock = stage, clock
        self.speed = float(schedule.speed)
        self._advance, self._period = float(schedule.advance), float(schedule.cadence.period)
        self._frame, self._patterns = float(SECOND / (display.slot_rate / display.patterns)), display.patterns
        self._unit = self._advance / repeats
        self._seen: deque[tuple[int, float]] = deque()
        self._ask = Asking(clock, stage.position, self._frame / 2)
        self.origin = 0.0

    def read(self, refreshed: int) -> Reading:
        """Ask the stage. refreshed: when a refresh was seen last [ns]."""
        now, angle = self._ask()
        self._seen.append((now, angle))
        while now - self._seen[0][0] > WINDOW:
            self._seen.popleft()
        since, age = divmod(now - refreshed, self._frame)
        here = angle - self.origin
        return Reading(here, (here - self.speed * age / SECOND) / self._unit, int(since), self._error())

    def _error(self) -> float:
        (began, start), (now, angle) = self._seen[0], self._seen[-1]
        return (angle - start) / self._advance - (now - began) / self._period

    def up(self, first: int, refresh: Callable[[], int]) -> None:
        """Turn at the speed and in step with the cable, until pose ``first`` is `LEAD` away.

        refresh: shows black, and returns the time of its refresh [ns]. Raises `InterlockOpen`.
        """
        self._stage.run(self.speed)
        self._settle(refresh)
        for _ in range(TRIES):
            ahead = self._ahead(refresh)
            if abs(ahead) <= STEP:
                break
            self._stage.run(self.speed * (1 - ahead / (NUDGE * self._patterns)))
            for _ in range(NUDGE):
                refresh()
            self._stage.run(self.speed)
            self._settle(refresh)
        else:
            log.warning("the stage is %.2g slots from being in step with the cable: pictures are so far off", ahead)
        self._meet(first, refresh)

    def _settle(self, refresh: Callable[[], int]) -> None:
        """Wait for the speed."""
        self._seen.clear()
        began = self._clock.now()
        while True:
            self.read(refresh())
            now = self._seen[-1][0]
            if now - self._seen[0][0] >= SETTLED:
                if abs(self._error()) <= EVEN:
                    return
                self._seen.clear()
            if now - began > SPIN_UP:
                raise InterlockOpen(
                    f"the stage does not turn at {self.speed:.4g} deg/s after {SPIN_UP // SECOND} s: "
                    "check motor, load and the degrees that its gear makes"
                )

    def _ahead(self, refresh: Callable[[], int]) -> float:
        """How far the stage is ahead of the nearest slot, over some video frames [slots]."""
        slots = [self.read(refresh()).slots - number * self._patterns for number in range(NUDGE)]
        mean = sum(slots) / len(slots)
        return mean - round(mean)

    def _meet(self, first: int, refresh: Callable[[], int]) -> None:
        """Turn on until a pose is near."""
        self.origin = 0.0
        goal, lead = first * self._advance, LEAD * self.speed
        left = goal - self.read(refresh()).degrees
        self.origin = 360.0 * ceil((lead - left) / 360.0)
        while goal - self.read(refresh()).degrees > lead:
            if abs(self._error()) > 0.5:
                raise InterlockOpen("the stage lost its speed before the first picture; check motor and load")

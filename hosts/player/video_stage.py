"""The stage of a vial, counted in slots of a video cable, and which of these slots were lit."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import ceil, floor

from vamgpu.hosts.drivers.stages import Stage
from vamgpu.hosts.player.motor import SpeedMonitor
from vamgpu.hosts.safety.interlock import InterlockOpen
from vamgpu.hosts.schedules.clock import Clock, TimedQuery
from vamgpu.hosts.schedules.limits import HdmiTiming
from vamgpu.hosts.schedules.schedule import Schedule
from vamgpu.hosts.schedules.timing import SECOND

ASIDE = 0.75
"""Distance of the stage from the count of slots beyond which the count is corrected [slots]."""


@dataclass(frozen=True)
class SlotLight:
    """Light of some slots."""

    times: int  # slots of light, more than one for a slot that a screen repeated
    late: int  # the most that one came after the stage was at its angle [ns]
    missing: tuple[int, ...]  # slots that were not shown


class SlotCounter:
    """Counts slots by the stage, evenly where it is near enough, and keeps what was sent for them until it is taken."""

    def __init__(self, display: HdmiTiming) -> None:
        self._patterns, self._ahead = display.patterns, display.latency * display.patterns
        self._slot = float(SECOND / display.slot_rate)
        self._frames: deque[tuple[int, tuple[int, ...]]] = deque([(0, ()), (0, ())], maxlen=2)
        self._times: dict[int, int] = {}
        self._late: dict[int, int] = {}
        self.begins: int | None = None

    def saw(self, slots: float, since: int) -> None:
        """Take the stage's word. slots: where it was at the last refresh.  since: refreshes after the last frame's."""
        nearest = floor(slots + 0.5)
        expected = nearest if self.begins is None else self.begins + self._patterns
        self.begins = expected if abs(slots - expected) <= ASIDE else nearest
        slipped = max((self.begins - expected) // self._patterns, 0)
        (_, before), (first, last) = self._frames
        for sent, repeated in ((before, max(slipped - since, 0)), (last, since)):
            for slot in sent:  # a screen repeats the frame that none has replaced
                if slot in self._times:
                    self._times[slot] += repeated
        behind = slots - since * self._patterns + self._ahead - first
        self._late |= {slot: round(behind * self._slot) for slot in last if slot in self._times}

    def next(self) -> range:
        """The slots of the next video frame: it goes out at the next refresh and is lit ``latency`` later."""
        first = (self.begins or 0) + self._patterns + self._ahead
        return range(first, first + self._patterns)

    def sent(self, first: int, slots: Sequence[int]) -> None:
        """A video frame for slots from ``first`` on has frames for ``slots``, and black for the others."""
        self._frames.append((first, tuple(slots)))
        self._times |= dict.fromkeys(slots, 1)

    def take(self, slots: Sequence[int]) -> SlotLight:
        """The light of slots that the stage is past; they are forgotten."""
        late = max((self._late.pop(slot, 0) for slot in slots), default=0)
        missing = tuple(slot for slot in slots if slot not in self._times)
        return SlotLight(sum(self._times.pop(slot, 0) for slot in slots), late, missing)


log: logging.Logger = logging.getLogger(__name__)
SPIN_UP = 10 * SECOND  # longest wait for the stage to have its speed [ns]
SETTLED = SECOND // 4  # for how long it must have kept it [ns]
EVEN = 0.05  # greatest error at its speed [poses]
RUN_UP = 12.0  # of a web, until it is in step with the cable [s]
BACK = 4  # how much faster a web goes back
LEAD = 0.25  # how long before its first frame a stage is ready for light [s]
NUDGE = 15  # video frames in which the stage is brought into step with the cable
TRIES = 4  # how often that is tried
STEP = 0.02  # greatest distance from being in step [slots]


@dataclass(frozen=True)
class StageReading:
    """A reading of the stage."""

    degrees: float  # since pose 0
    slots: float  # of the cable since pose 0, at the last refresh
    since: int  # refreshes after the one that was seen
    error: float  # within the last second [poses]


class StageTracker:
    """The stage of one print; a vial turns forward only, pose 0 at its zero. repeats: slots of the cable in a pose."""

    def __init__(self, stage: Stage, clock: Clock, schedule: Schedule, display: HdmiTiming, repeats: int) -> None:
        self._stage, self._clock = stage, clock
        self.speed: float = float(schedule.speed)
        self._advance = float(schedule.advance)
        self._frame, self._patterns = float(SECOND / (display.slot_rate / display.patterns)), display.patterns
        self._unit = self._advance / repeats
        self._motion = SpeedMonitor(schedule)
        self._ask = TimedQuery(clock, stage.position, self._frame / 2)
        self.origin: float = 0.0
        self._units, self._web, self._placed = schedule.unit, schedule.unit == "mm", False

    def read(self, refreshed: int) -> StageReading:
        """Ask the stage. refreshed: when a refresh was seen last [ns]."""
        now, angle = self._ask()
        since, age = divmod(now - refreshed, self._frame)
        here = angle - self.origin
        slots, error = (here - self.speed * age / SECOND) / self._unit, self._motion.error(now, angle)
        return StageReading(here, slots, int(since), error)

    def up(self, first: int, refresh: Callable[[], int]) -> None:
        """Move in step with the cable until a pose is `LEAD` away. refresh: shows black, returns its time [ns]."""
        if self._web:
            self._back(first)
        self._stage.run(self.speed)
        self._settle(refresh)
        if not self._web and (marks := getattr(self._stage, "marks", None)) is not None:
            while getattr(self._stage, "marks", None) == marks:  # pose 0 is at the index: it is found again each time
                self.read(refresh())
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
            log.warning("the stage is %.2g slots from being in step with the cable: frames are so far off", ahead)
        self._meet(first, refresh)

    def _back(self, first: int) -> None:
        """Where there is room for a run-up: a web begins where it stands, and moves back."""
        self._stage.run(0.0)
        self._stage.wait()
        if not self._placed:
            self.origin, self._placed = self._stage.position(), True
        self._stage.move(self.origin + first * self._advance - RUN_UP * self.speed, BACK * self.speed)
        self._stage.wait()

    def _settle(self, refresh: Callable[[], int]) -> None:
        """Wait for the speed."""
        self._motion.restart()
        began = self._clock.now()
        while True:
            self.read(refresh())
            if self._motion.span >= SETTLED:
                if abs(self._motion.last) <= EVEN:
                    return
                self._motion.restart()
            if self._clock.now() - began > SPIN_UP:
                raise InterlockOpen(
                    f"the stage does not move at {self.speed:.4g} {self._units}/s after {SPIN_UP // SECOND} s: "
                    f"check motor, load and the {self._units} that its gear makes of a step"
                )

    def _ahead(self, refresh: Callable[[], int]) -> float:
        """Distance of the stage ahead of the nearest slot, over some video frames [slots]."""
        slots = [self.read(refresh()).slots - number * self._patterns for number in range(NUDGE)]
        mean = sum(slots) / len(slots)
        return mean - round(mean)

    def _meet(self, first: int, refresh: Callable[[], int]) -> None:
        """Turn on until a pose is near."""
        goal, lead = first * self._advance, LEAD * self.speed
        if not self._web:
            self.origin = 0.0
            left = goal - self.read(refresh()).degrees
            self.origin = 360.0 * ceil((lead - left) / 360.0)
        elif goal - self.read(refresh()).degrees < lead:
            raise InterlockOpen("the web has its speed too late; check motor and load")
        while goal - self.read(refresh()).degrees > lead:
            if abs(self._motion.last) > 0.5:
                raise InterlockOpen("the stage lost its speed before the first frame; check motor and load")

"""Plays a vial's schedule on a video projector: the stage's angle, not the clock, selects the frame of every slot."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import ceil, floor
from typing import Any

import numpy as np

from vamgpu.errors import Underrun
from vamgpu.hosts.drivers.cleanup import all_of
from vamgpu.hosts.drivers.stages import Stage
from vamgpu.hosts.frames.lateness import Repeats, VialLatePolicy, WebLatePolicy
from vamgpu.hosts.frames.versions import FrameVersion, FrameVersions
from vamgpu.hosts.player.machines import ScreenBlackout, VideoFrames, VideoMachines, gate, recover
from vamgpu.hosts.player.motor import SpeedMonitor
from vamgpu.hosts.player.player import Renew, StatusPoll
from vamgpu.hosts.records.record import FrameRecord
from vamgpu.hosts.safety.interlock import InterlockOpen
from vamgpu.hosts.safety.light import Lamp, Switch
from vamgpu.hosts.schedules.clock import Clock, TimedQuery
from vamgpu.hosts.schedules.limits import HdmiTiming
from vamgpu.hosts.schedules.schedule import NONE, Schedule
from vamgpu.hosts.schedules.timing import SECOND

log: logging.Logger = logging.getLogger(__name__)
ASIDE = 0.75  # difference of stage and slot count above which the count is corrected [slots]


@dataclass(frozen=True)
class SlotLight:
    times: int  # slots of light, more than one if a screen repeated a slot
    late: int  # greatest delay of one after the stage was at its angle [ns]
    missing: tuple[int, ...]  # slots that were not shown


class SlotCounter:
    """Counts slots evenly while the stage is near its slot, else by the stage; keeps frames until they are read."""

    def __init__(self, display: HdmiTiming, step: float = 0.0) -> None:
        self._aside = ASIDE + step / 2
        self._patterns, self._ahead = display.patterns, display.latency * display.patterns
        self._slot = float(SECOND / display.slot_rate)
        self._frames: deque[tuple[int, tuple[int, ...]]] = deque([(0, ()), (0, ())], maxlen=2)
        self._times: dict[int, int] = {}
        self._late: dict[int, int] = {}
        self._counted = 0  # number of refreshes counted since that of the last frame
        self.begins: int | None = None

    def saw(self, slots: float, since: int) -> None:
        """Update from the reported position. slots: at the last refresh.  since: refreshes after the last frame's."""
        nearest = floor(slots + 0.5)
        expected = nearest if self.begins is None else self.begins + self._patterns
        self.begins = expected if abs(slots - expected) <= self._aside else nearest
        slipped = max((self.begins - expected) // self._patterns, 0)
        (_, before), (first, last) = self._frames
        counted, self._counted = self._counted, since
        for sent, repeated in ((before, max(slipped - since, 0)), (last, since - counted)):
            for slot in sent:  # a screen repeats a frame until a new one arrives
                if slot in self._times:
                    self._times[slot] += repeated
        behind = slots - since * self._patterns + self._ahead - first
        self._late |= {slot: round(behind * self._slot) for slot in last if slot in self._times}

    def next(self) -> range:
        """The slots of the next video frame: it goes out at the next refresh and is lit ``latency`` later."""
        first = (self.begins or 0) + self._patterns + self._ahead
        return range(first, first + self._patterns)

    @property
    def past(self) -> int:
        """Slots before this one can no longer be lit; a frame that was sent late is lit after its angle."""
        first, last = self._frames[-1]
        return min(self.begins or 0, first) if last else self.begins or 0

    def sent(self, first: int, slots: Sequence[int]) -> None:
        """A video frame for slots from ``first`` on has frames for ``slots``, and black for the others."""
        self._frames.append((first, tuple(slots)))
        self._counted = 0
        self._times |= dict.fromkeys(slots, 1)

    def take(self, slots: Sequence[int]) -> SlotLight:
        """The light of slots behind the stage, which are dropped."""
        late = max((self._late.pop(slot, 0) for slot in slots), default=0)
        missing = tuple(slot for slot in slots if slot not in self._times)
        return SlotLight(sum(self._times.pop(slot, 0) for slot in slots), late, missing)


SPIN_UP = 10 * SECOND  # longest wait for the stage's speed [ns]
SETTLED = SECOND // 4  # time for which it must keep its speed [ns]
EVEN = 0.05  # greatest error of its speed [poses]
BACK = 4  # speed of a web's return, relative to its speed
LEAD = 0.25  # time before its first frame at which a stage is ready [s]
NUDGE = 15  # video frames for bringing the stage into step with the cable
TRIES = 4  # number of tries
STEP = 0.02  # greatest phase error [slots]


@dataclass(frozen=True)
class StageReading:
    degrees: float  # position since pose 0
    slots: float  # slots of the cable since pose 0, at the last refresh
    since: int  # refreshes after the observed one
    error: float  # error within the last second [poses]


class StageTracker:
    """The stage of one print; a vial only turns forwards, pose 0 at its zero. repeats: slots of the cable per pose."""

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
        """Read the stage. refreshed: time of the last observed refresh [ns]."""
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
            log.warning("the stage is %.2g slots out of step with the cable: frames are off by as much", ahead)
        self._meet(first, refresh)

    def _back(self, first: int) -> None:
        """Position with room for a run-up: a web starts at its present position, and moves back."""
        self._stage.run(0.0)
        self._stage.wait()
        if not self._placed:
            self.origin, self._placed = self._stage.position(), True
        self._stage.move(self.origin + first * self._advance - VideoMachines.run_up * self.speed, BACK * self.speed)
        self._stage.wait()

    def _settle(self, refresh: Callable[[], int]) -> None:
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
                    "check motor, load and microsteps in [motion]"
                )

    def _ahead(self, refresh: Callable[[], int]) -> float:
        """Lead of the stage over the nearest slot, during some video frames [slots]."""
        slots = [self.read(refresh()).slots - number * self._patterns for number in range(NUDGE)]
        mean = sum(slots) / len(slots)
        return mean - round(mean)

    def _meet(self, first: int, refresh: Callable[[], int]) -> None:
        """Keep turning until a pose is near."""
        goal, lead = first * self._advance, LEAD * self.speed
        if not self._web:
            self.origin = 0.0
            left = goal - self.read(refresh()).degrees
            self.origin = 360.0 * ceil((lead - left) / 360.0)
        elif goal - self.read(refresh()).degrees < lead:
            raise InterlockOpen("the web reached its speed too late; check motor and load")
        while goal - self.read(refresh()).degrees > lead:
            if abs(self._motion.last) > 0.5:
                raise InterlockOpen("the stage lost its speed before the first frame; check motor and load")


WINDOW, BORNE = 360, 2  # poses that light a voxel of a web, and those of them that may be lost
STATUS = 6  # video frames between two status queries to the controller; its events are read at each


class SpinningPlayer:
    """Plays the schedule of `vamgpu.hosts.schedules.video`; ``turns`` are added at most for missed slots."""

    lamp: Lamp
    renew: Renew

    def __init__(
        self, schedule: Schedule, display: HdmiTiming, machines: VideoMachines, frames: VideoFrames, *,
        turns: int = 1, versions: FrameVersions | None = None,
    ) -> None:  # fmt: skip
        machines.check(schedule, display)
        self.schedule: Schedule = schedule
        self.display = display
        self.machines = machines
        self.clock: Clock = machines.clock
        self.lamp, self.renew = gate(machines.controller, machines.lamp, range(schedule.engines), schedule.power[0])
        self._blackout = ScreenBlackout(machines.projector)
        self.switches: Mapping[str, Switch] = {"projector": self._blackout}
        self._frames, self._turns, self._planned = frames, turns, len(schedule)
        self.versions: FrameVersions | None = versions
        self._repeats = int(schedule.cadence.period * display.slot_rate / SECOND)
        self._on = int(schedule.on[0]) // self._repeats
        self._turn = schedule.frames * self._repeats
        self._turning = StageTracker(machines.stage, machines.clock, schedule, display, self._repeats)
        self._missed = Repeats(
            VialLatePolicy(schedule.frames * self._repeats) if schedule.repeats
            else WebLatePolicy(WINDOW * self._repeats, BORNE * self._repeats)
        )  # fmt: skip
        self._black = np.zeros(machines.projector.size, np.uint8)
        self._again: dict[int, int] = {}  # slots of an added turn, and their versions
        self._added = self._refreshed = 0
        self._begin(0)

    def _begin(self, first: int) -> None:
        self._first, self._kept, self._limit = first, first, len(self.schedule)
        self._sent, self._polls, self._stopped = first * self._repeats - 1, 0, False
        self._sure = self._confirmed = first
        per_slot = self._repeats / float(self.schedule.advance)
        fine: float | None = getattr(self.machines.stage, "microsteps", None)
        self._lit = SlotCounter(self.display, per_slot / fine if fine else 0.0)

    def prime(self, first: int, alive: Callable[[], None]) -> int:
        """Show black, and bring the stage to its speed, in step with the cable, a little before the angle of a slot."""
        self._begin(first)
        self._blackout.own()

        def refresh() -> int:
            self._show([self._black] * self.display.patterns)
            alive()
            return self._refreshed

        self._turning.up(first, refresh)
        return round(LEAD * SECOND)

    def facts(self) -> dict[str, Any]:
        """Position of pose 0 on the stage [deg], in whole turns."""
        return {"origin": self._turning.origin}

    def start(self) -> None:
        """Read the controller's events from now on; frames follow the stage."""
        if self.machines.controller is not None:
            self.machines.controller.poll()

    def poll(self) -> StatusPoll:
        """Position of the stage, and the light before it."""
        seen = self._turning.read(self._refreshed)
        self._lit.saw(seen.slots, seen.since)
        fault = self._fault()  # first: it may raise, and past records would be lost
        frames, done = self._passed(), self._kept - self._first
        margin = self.display.latency * self.display.patterns / float(self.display.slot_rate)
        running = self._kept < self._limit
        if fault is None and not self._blackout.dark:
            self._sure = self._kept
        return StatusPoll(running, seen.error, done, done, frames, seen.degrees, 1.0, margin, fault)

    def _fault(self) -> str | None:
        """Why the controller switched the light off."""
        if (controller := self.machines.controller) is None:
            return None
        reasons = [words[2] for words in controller.poll() if words[:2] == ("light", "off")]
        if self._polls % STATUS == 0 and not reasons:
            status = controller.status()
            reasons = [] if status.light else [status.fault]
            if reasons:  # its event was missed
                self._sure = self._confirmed
            self._confirmed = self._kept
        self._polls += 1
        return f"the controller switched the light off: {reasons[0]}" if reasons else None

    def _passed(self) -> tuple[FrameRecord, ...]:
        """Records of the poses behind the stage."""
        found, past = [], (self._lit.begins or 0) if self._blackout.dark else self._lit.past
        while self._kept < self._limit and (self._kept + 1) * self._repeats <= past:
            found.append(self._shown(self._kept))
            self._kept += 1
        return tuple(found)

    def _shown(self, pose: int) -> FrameRecord:
        wanted = self._wanted(pose)
        light = self._lit.take(wanted)
        for slot in light.missing:
            self._stopped |= self._missed.policy.drop(slot)
            self._missed.miss(slot % self._turn, self._version(slot))
        dark = bool(wanted) and not light.times
        on = self._on * (len(wanted) if dark else light.times)
        frame, start = int(self.schedule.frame[pose]) if wanted else NONE, int(self.schedule.light[pose])
        version = self._version(wanted[0]) if wanted else 0
        return FrameRecord(pose, frame, pose, start, on, late=light.late, dark=dark, version=version)

    def _version(self, slot: int) -> int:
        """The version of the frames in a slot of the cable."""
        if self.versions is None:
            return 0
        return self._again[slot] if slot in self._again else self.versions.at(slot // self._repeats)

    def _wanted(self, pose: int) -> list[int]:
        """Slots of the cable for a pose; in an added turn only the missed ones."""
        slots = range(pose * self._repeats, (pose + 1) * self._repeats)
        planned = self._planned if self.versions is None else self.versions.end
        return [slot for slot in slots if pose < planned or slot in self._again]

    def feed(self) -> None:
        """Show the frames of the next video frame; returns at its refresh. Raises `Underrun`, `DeviceLost`."""
        if self._stopped:
            raise Underrun(
                f"{self._missed.policy.stopped}: the light is off; turn slower, or check what delays the host"
            )
        slots = self._lit.next()
        frames = {slot: frame for slot in slots if (frame := self._at(slot)) is not None}
        self._show([frames.get(slot, self._black) for slot in slots])
        self._lit.sent(slots[0], list(frames))
        self._sent = max(self._sent, min(slots[-1], self._limit * self._repeats - 1))

    def _at(self, slot: int) -> np.ndarray | None:
        """The frame of a slot; None if it is dark, not ready, or was shown before the stage moved back."""
        pose = slot // self._repeats
        if slot <= self._sent or pose >= self._limit or slot not in self._wanted(pose):
            return None
        version = 0 if self.versions is None else self.versions.frames * self._version(slot)
        return self._frames.frame(int(self.schedule.frame[pose]) + version)

    def swap(self, version: FrameVersion) -> bool:
        """Show a version from its turn on: the frame of a slot is selected when it is sent."""
        assert self.versions is not None, "with versions"
        begin = version.turn * self.versions.count
        if begin < self._kept or begin * self._repeats <= self._sent:
            return False
        self.versions.commit(version)
        return True

    def _show(self, frames: list[np.ndarray]) -> None:
        if self._blackout.dark:
            frames = [self._black] * len(frames)
        self.machines.projector.show(frames)
        self._refreshed = self.clock.now()

    @property
    def pending_versions(self) -> set[int]:
        return self._missed.missed

    def wait(self) -> None:
        """Return at once: sending waits for a video frame."""

    def finish(self) -> None:
        """End after the present frame, in all its slots."""
        self._limit = min(self._limit, self._sent // self._repeats + 1)

    def doubtful(self) -> range:
        """Sent slots that were not past at the last poll with light."""
        self._kept = max(self._kept, self._sent // self._repeats + 1)
        return range(self._sure, max(self._sure, self._sent // self._repeats + 1))

    def recover(self) -> None:
        """Reconnect to the controller, and drop its earlier events."""
        recover(self.machines)
        if self.machines.controller is not None:
            self.machines.controller.poll()

    def halt(self) -> None:
        """Show black, and stop the stage; each even if the other fails."""
        all_of(self.machines.stage.stop, self._blackout.off, self.machines.stage.wait)

    def add_repeats(self) -> bool:
        """Add a turn with the missed slots. Raises `Underrun` if the added turns did not show them."""
        if not (due := self._missed.collect()):
            return False
        if self._added == self._turns:
            raise Underrun(
                f"{due.total()} slots of frames were missed; {self._turns} added turns did not show them: "
                "turn slower, or check what delays the host"
            )
        self._added += 1
        begin = len(self.schedule) * self._repeats
        self._again = {begin + slot: self._missed.version(slot, 0) for slot in due}
        self.schedule = self.schedule.turned_again({slot // self._repeats for slot in due})
        self._missed.added()
        return True

    def repeat(self, slots: range) -> None:
        for slot in (each for pose in slots for each in self._wanted(pose)):  # none is dark
            self._missed.policy.drop(slot % self._turn)
            self._missed.miss(slot % self._turn, self._version(slot))

    def frame(self, number: int, engine: int = 0) -> np.ndarray:
        version = 0 if self.versions is None else self.versions.frames * self.versions.at(self._kept)
        frame = self._frames.frame(number + version)
        return self._black if frame is None else frame

"""Plays a vial's schedule on a video projector: the stage's angle chooses the frame of every slot, never the clock.

The light is steady, and black frames make the dark. What a slot did not show is shown in an added turn.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from vamgpu.errors import Underrun
from vamgpu.hosts.drivers.cleanup import run_all
from vamgpu.hosts.frames.lateness import Action, Repeats, VialLatePolicy, WebLatePolicy
from vamgpu.hosts.frames.versions import FrameVersion, FrameVersions
from vamgpu.hosts.player.machines import ScreenBlackout, VideoFrames, VideoMachines, gate
from vamgpu.hosts.player.player import Renew, StatusPoll
from vamgpu.hosts.player.video_stage import LEAD, SlotCounter, StageTracker
from vamgpu.hosts.records.record import FrameRecord
from vamgpu.hosts.safety.light import Lamp, Switch
from vamgpu.hosts.schedules.clock import Clock
from vamgpu.hosts.schedules.limits import HdmiTiming
from vamgpu.hosts.schedules.schedule import NONE, Schedule
from vamgpu.hosts.schedules.timing import SECOND

WINDOW, BORNE = 360, 2  # poses that a voxel of a web sees, and those of them that may be lost
STATUS = 6  # after so many video frames the controller is asked what it does; what it says by itself is heard at each


class SpinningPlayer:
    """Plays the schedule of `vamgpu.hosts.schedules.video`; pose 0 is at the zero of the stage.

    turns: most that are added for what was missed.
    """

    schedule: Schedule
    display: HdmiTiming
    machines: VideoMachines
    clock: Clock
    lamp: Lamp
    renew: Renew

    def __init__(
        self, schedule: Schedule, display: HdmiTiming, machines: VideoMachines, frames: VideoFrames, *,
        turns: int = 1, versions: FrameVersions | None = None,
    ) -> None:  # fmt: skip
        machines.check(schedule, display)
        self.schedule, self.display, self.machines, self.clock = schedule, display, machines, machines.clock
        self.lamp, self.renew = gate(machines.controller, machines.lamp, schedule)
        self._blackout = ScreenBlackout(machines.projector)
        self.switches: Mapping[str, Switch] = {"projector": self._blackout}
        self._frames, self._turns, self._planned = frames, turns, len(schedule)
        self.versions: FrameVersions | None = versions
        self._repeats = int(schedule.cadence.period * display.slot_rate / SECOND)
        self._on = int(schedule.on[0]) // self._repeats
        self._turn = schedule.frames * self._repeats
        self._turning = StageTracker(machines.stage, machines.clock, schedule, display, self._repeats)
        self._missed = Repeats(
            VialLatePolicy(schedule.frames * self._repeats) if schedule.unit == "deg"
            else WebLatePolicy(WINDOW * self._repeats, BORNE * self._repeats)
        )  # fmt: skip
        self._black = np.zeros(machines.projector.size, np.uint8)
        self._again: dict[int, int] = {}  # slots of an added turn, and the versions that they show
        self._added = self._refreshed = 0
        self._begin(0)

    def _begin(self, first: int) -> None:
        self._first, self._kept, self._limit = first, first, len(self.schedule)
        self._sent, self._polls, self._stopped = first * self._repeats - 1, 0, False
        self._sure = self._confirmed = first
        self._lit = SlotCounter(self.display)

    # ---- before the light ------------------------------------------------------------------------------------
    def prime(self, first: int, alive: Callable[[], None]) -> int:
        """Black, and the stage at its speed, in step with the cable and a little before the angle of a slot."""
        self._begin(first)
        self._blackout.own()

        def refresh() -> int:
            self._show([self._black] * self.display.patterns)
            alive()
            return self._refreshed

        self._turning.up(first, refresh)
        return round(LEAD * SECOND)

    def facts(self) -> dict[str, Any]:
        """Where pose 0 is on the stage [deg]: whole turns."""
        return {"origin": self._turning.origin}

    # ---- in the light ----------------------------------------------------------------------------------------
    def start(self) -> None:
        """Listen to the controller from here on; frames follow the stage."""
        if self.machines.controller is not None:
            self.machines.controller.poll()

    def poll(self) -> StatusPoll:
        """Where the stage is, and what was lit before it."""
        seen = self._turning.read(self._refreshed)
        self._lit.saw(seen.slots, seen.since)
        fault = self._fault()  # first: it may raise, and what is past would be lost
        frames, done = self._passed(), self._kept - self._first
        margin = self.display.latency * self.display.patterns / float(self.display.slot_rate)
        running = self._kept < self._limit
        if fault is None:
            self._sure = self._kept
        return StatusPoll(running, seen.error, done, done, frames, seen.degrees, 1.0, margin, fault)

    def _fault(self) -> str | None:
        """Why the controller closed the light by itself."""
        if (controller := self.machines.controller) is None:
            return None
        reasons = [words[2] for words in controller.poll() if words[:2] == ("light", "off")]
        if self._polls % STATUS == 0 and not reasons:
            status = controller.status()
            reasons = [] if status.light else [status.fault]
            if reasons:  # it had said so, and nobody heard
                self._sure = self._confirmed
            self._confirmed = self._kept
        self._polls += 1
        return f"the controller closed the light: {reasons[0]}" if reasons else None

    def _passed(self) -> tuple[FrameRecord, ...]:
        """Records of the poses that the stage is past."""
        found = []
        while self._kept < self._limit and (self._kept + 1) * self._repeats <= (self._lit.begins or 0):
            found.append(self._shown(self._kept))
            self._kept += 1
        return tuple(found)

    def _shown(self, pose: int) -> FrameRecord:
        wanted = self._wanted(pose)
        light = self._lit.take(wanted)
        for slot in light.missing:
            self._stopped |= self._missed.policy.drop(slot) is Action.STOP
            self._missed.miss(slot % self._turn, self._version(slot))
        dark = bool(wanted) and not light.times
        on = self._on * (len(wanted) if dark else light.times)
        frame, start = int(self.schedule.frame[pose]) if wanted else NONE, int(self.schedule.light[pose])
        version = self._version(wanted[0]) if wanted else 0
        return FrameRecord(pose, frame, pose, start, on, late=light.late, dark=dark, version=version)

    def _version(self, slot: int) -> int:
        """The version of the frames that a slot of the cable shows."""
        if self.versions is None:
            return 0
        return self._again[slot] if slot in self._again else self.versions.at(slot // self._repeats)

    def _wanted(self, pose: int) -> list[int]:
        """Slots of the cable in which a pose is to be lit: in an added turn those that were missed."""
        slots = range(pose * self._repeats, (pose + 1) * self._repeats)
        planned = self._planned if self.versions is None else self.versions.end
        return [slot for slot in slots if pose < planned or slot in self._again]

    def feed(self) -> None:
        """Show the frames of the next video frame; returns at its refresh. Raises `Underrun`, `DeviceLost`."""
        if self._stopped:
            raise Underrun(
                f"{self._missed.policy.stopped}: the light is off; turn slower, or look at what holds up the host"
            )
        slots = self._lit.next()
        frames = {slot: frame for slot in slots if (frame := self._at(slot)) is not None}
        self._show([frames.get(slot, self._black) for slot in slots])
        self._lit.sent(slots[0], list(frames))
        self._sent = max(self._sent, min(slots[-1], self._limit * self._repeats - 1))

    def _at(self, slot: int) -> np.ndarray | None:
        """The frame of a slot; None where it is dark, not there yet, or was shown before the stage came back."""
        pose = slot // self._repeats
        if slot <= self._sent or pose >= self._limit or slot not in self._wanted(pose):
            return None
        version = 0 if self.versions is None else self.versions.frames * self._version(slot)
        return self._frames.frame(int(self.schedule.frame[pose]) + version)

    def swap(self, version: FrameVersion) -> bool:
        """Show a version from its turn on: the frame of a slot is chosen when it is sent."""
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
        """Versions of slots that were not shown."""
        return self._missed.missed

    def wait(self) -> None:
        """At once: a video frame was waited for."""

    # ---- after the light -------------------------------------------------------------------------------------
    def finish(self) -> None:
        """End after the frame on its way, in all its slots."""
        self._limit = min(self._limit, self._sent // self._repeats + 1)

    def doubtful(self) -> range:
        """Slots that were sent and not past when the light was seen last."""
        self._kept = max(self._kept, self._sent // self._repeats + 1)
        return range(self._sure, max(self._sure, self._sent // self._repeats + 1))

    def recover(self) -> None:
        """Reach the controller again, which says nothing any more of how the light went off."""
        if self.machines.controller is not None:
            self.machines.controller.revive()
            self.machines.controller.poll()

    def halt(self) -> None:
        """Black, and the stage to rest; each whatever the other did."""
        if failed := run_all(self.machines.stage.stop, self._blackout.off, self.machines.stage.wait):
            raise failed[0]

    def add_repeats(self) -> bool:
        """Add a turn that shows again what was missed. Raises `Underrun` where the added turns did not show it."""
        if not (due := self._missed.collect()):
            return False
        if self._added == self._turns:
            raise Underrun(
                f"{due.total()} slots of frames were missed; {self._turns} added turns did not show them: "
                "turn slower, or look at what holds up the host"
            )
        self._added += 1
        begin = len(self.schedule) * self._repeats
        self._again = {begin + slot: self._missed.version(slot, 0) for slot in due}
        self.schedule = self.schedule.turned_again({slot // self._repeats for slot in due})
        self._missed.added()
        return True

    def frame(self, number: int, engine: int = 0) -> np.ndarray:
        """A frame for people; there is one projector."""
        version = 0 if self.versions is None else self.versions.frames * self.versions.at(self._kept)
        frame = self._frames.frame(number + version)
        return self._black if frame is None else frame

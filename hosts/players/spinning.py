"""Plays a vial's schedule on a video projector: the stage's angle chooses the picture of every slot, never the clock.

The light is steady and black pictures make the dark, so the lamp may open a little before the first picture. What a
slot showed, or did not, is known once the stage is past it: what is missing is owed, and shown in a turn more.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from vamgpu.errors import Underrun
from vamgpu.hosts.insist import insist
from vamgpu.hosts.pictures.underrun import Action, VialUnderrun
from vamgpu.hosts.players.cable import Blackout, VideoMachines, VideoPictures
from vamgpu.hosts.players.lit import Lit
from vamgpu.hosts.players.player import Look
from vamgpu.hosts.players.turning import LEAD, Turning
from vamgpu.hosts.record import Shown
from vamgpu.hosts.safety.lamp import ControllerLamp, Renewal
from vamgpu.hosts.safety.light import Switch
from vamgpu.hosts.schedules.limits import HdmiTiming
from vamgpu.hosts.schedules.schedule import Schedule
from vamgpu.hosts.schedules.timing import SECOND

STATUS = 6
"""After so many video frames the controller is asked what it does; what it says by itself is heard at each."""

class SpinningPlayer:
    """Plays the schedule of `vamgpu.hosts.schedules.video.vial`; see `vamgpu.hosts.players.player.Player`.

    display: that the schedule was made for.  turns: most that are added for what was missed. Pose 0 is at the stage's
    zero and the vial turns on forward, so a print that is resumed, by whichever host, meets every pose at its angle.
    Raises `BadInput`, and `WrongDevice` for another projector.
    """

    def __init__(
        self, schedule: Schedule, display: HdmiTiming, machines: VideoMachines, pictures: VideoPictures, *,
        turns: int = 1,
    ) -> None:  # fmt: skip
        machines.check(schedule, display)
        self.schedule, self.display, self.machines, self.clock = schedule, display, machines, machines.clock
        self.lamp = ControllerLamp(machines.controller, steady=True, shares=schedule.power[0])
        self._blackout = Blackout(machines.projector)
        self.switches: Mapping[str, Switch] = {"projector": self._blackout}
        self.renew = Renewal(machines.controller)
        self._pictures, self._turns, self._planned = pictures, turns, len(schedule)
        self._repeats = int(schedule.cadence.period * display.slot_rate / SECOND)
        self._on = int(schedule.on[0]) // self._repeats
        self._turning = Turning(machines.stage, machines.clock, schedule, display, self._repeats)
        self._policy = VialUnderrun(schedule.frames * self._repeats)
        self._black = np.zeros(machines.projector.size, np.uint8)
        self._owed: Counter[int] = Counter()
        self._amended: frozenset[int] = frozenset()
        self._added = self._refreshed = 0
        self._begin(0)

    def _begin(self, first: int) -> None:
        self._first, self._kept, self._limit = first, first, len(self.schedule)
        self._sent, self._looks, self._stopped = first * self._repeats - 1, 0, False
        self._lit = Lit(self.display)

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
        """Listen to the controller from here on; pictures follow the stage."""
        self.machines.controller.poll()

    def look(self) -> Look:
        """Where the stage is, and what was lit before it."""
        seen = self._turning.read(self._refreshed)
        self._lit.saw(seen.slots, seen.since)
        pictures, done = self._passed(), self._kept - self._first
        margin = self.display.latency * self.display.patterns / float(self.display.slot_rate)
        running = self._kept < self._limit
        return Look(running, seen.error, done, done, pictures, seen.degrees, 1.0, margin, self._fault())

    def _fault(self) -> str | None:
        """Why the controller closed the light by itself."""
        reasons = [words[2] for words in self.machines.controller.poll() if words[:2] == ("light", "off")]
        if self._looks % STATUS == 0 and not reasons:
            status = self.machines.controller.status()
            reasons = [] if status.light else [status.fault]
        self._looks += 1
        return f"the controller closed the light: {reasons[0]}" if reasons else None

    def _passed(self) -> tuple[Shown, ...]:
        """What the poses showed that the stage is past."""
        found = []
        while self._kept < self._limit and (self._kept + 1) * self._repeats <= (self._lit.begins or 0):
            found.append(self._shown(self._kept))
            self._kept += 1
        return tuple(found)

    def _shown(self, pose: int) -> Shown:
        wanted = self._wanted(pose)
        light = self._lit.take(wanted)
        for slot in light.missing:
            self._stopped |= self._policy.lost(slot) is Action.STOP
        dark = bool(wanted) and not light.times
        on = self._on * (len(wanted) if dark else light.times)
        frame, start = int(self.schedule.frame[pose]), int(self.schedule.light[pose])
        return Shown(pose, frame, pose, start, on, late=light.late, dark=dark)

    def _wanted(self, pose: int) -> list[int]:
        """Slots of the cable in which a pose is to be lit: in an added turn those that were missed."""
        slots = range(pose * self._repeats, (pose + 1) * self._repeats)
        return [slot for slot in slots if pose < self._planned or slot in self._amended]

    def feed(self) -> None:
        """Show the pictures of the next video frame; returns at its refresh. Raises `Underrun`, `DeviceLost`."""
        if self._stopped:
            raise Underrun(f"{self._policy.stopped}: the light is off; turn slower, or look at what holds up the host")
        slots = self._lit.next()
        pictures = {slot: picture for slot in slots if (picture := self._at(slot)) is not None}
        self._show([pictures.get(slot, self._black) for slot in slots])
        self._lit.sent(slots[0], list(pictures))
        self._sent = max(self._sent, min(slots[-1], self._limit * self._repeats - 1))

    def _at(self, slot: int) -> np.ndarray | None:
        """The picture of a slot; None where it is dark, not there yet, or was shown before the stage came back."""
        pose = slot // self._repeats
        if slot <= self._sent or pose >= self._limit or slot not in self._wanted(pose):
            return None
        return self._pictures.picture(int(self.schedule.frame[pose]))

    def _show(self, pictures: list[np.ndarray]) -> None:
        if self._blackout.dark:
            pictures = [self._black] * len(pictures)
        self.machines.projector.show(pictures)
        self._refreshed = self.clock.now()

    def wait(self) -> None:
        """At once: a video frame was waited for."""

    # ---- after the light -------------------------------------------------------------------------------------
    def finish(self) -> None:
        """End after the picture on its way, in all its slots."""
        self._limit = min(self._limit, self._sent // self._repeats + 1)

    def halt(self) -> None:
        """Black, and the stage to rest; each whatever the other did."""
        if failed := insist(self.machines.stage.stop, self._blackout.off, self.machines.stage.wait):
            raise failed[0]

    def amends(self) -> bool:
        """Add a turn that shows again what was missed. Raises `Underrun` where the added turns did not show it."""
        self._owed += self._policy.owes()
        if not self._owed:
            return False
        if self._added == self._turns:
            raise Underrun(
                f"{self._owed.total()} slots of pictures were missed, and {self._turns} added turns did not show them; "
                "turn slower, or look at what holds up the host"
            )
        self._added += 1
        begin = len(self.schedule) * self._repeats
        self._amended = frozenset(begin + slot for slot in self._owed)
        self.schedule = self.schedule.turned_again({slot // self._repeats for slot in self._owed})
        self._owed -= Counter(list(self._owed))
        return True

    def picture(self, number: int) -> np.ndarray:
        """A frame for people."""
        picture = self._pictures.picture(number)
        return self._black if picture is None else picture

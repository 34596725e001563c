"""Plays a schedule on triggered mirrors: a controller moves, triggers and gates the light row by row, on its own.

The mirrors show the next picture at each trigger, so what is shown follows from how many triggers were counted, never
from a host's time; this side keeps pictures and rows ahead of the counter, and compares both counts.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from math import prod
from typing import Any

import numpy as np

from vamgpu.errors import BadInput, DeviceError, DeviceLost, Underrun
from vamgpu.hosts.drivers.dmd import SlotTiming
from vamgpu.hosts.drivers.stream import PlaneStream
from vamgpu.hosts.insist import insist
from vamgpu.hosts.pictures.stream import Pictures
from vamgpu.hosts.pictures.supply import Dark, Supply, guard, length
from vamgpu.hosts.pictures.underrun import Underruns
from vamgpu.hosts.players.approach import LOOK, Approach, Motion, Origin, own_number
from vamgpu.hosts.players.asking import Asking
from vamgpu.hosts.players.mirrors import Machines, shows, usual
from vamgpu.hosts.players.player import Look
from vamgpu.hosts.protocols.controller import Row, Status
from vamgpu.hosts.record import Shown
from vamgpu.hosts.safety.lamp import ControllerLamp, Renewal
from vamgpu.hosts.safety.light import Switch
from vamgpu.hosts.schedules.rows import Rows
from vamgpu.hosts.schedules.schedule import NONE, Schedule
from vamgpu.hosts.schedules.timing import SECOND, whole

PRIMING = 60 * SECOND
"""Longest wait for mirrors and buffers to be full before the light opens [ns]."""
PREROLL = 2
"""Black pictures that are triggered before the first slot: some mirrors show an unpredictable first picture, and both
counts must agree before there is light."""
APART = SECOND // 7
"""Least time between them, and to the first slot [ns]: some looks."""
PATIENCE = 0.25
"""How long a trigger may be overdue [s], by where the motion is."""
FORGOTTEN = (
    "the controller has another zero or play than this print: it lost its power, was reset, or served another program, "
    "so nobody knows where the motor is and what the resin saw; begin anew with fresh resin"
)
TURNS = 2
"""Most turns of a vial that are added for what was missed."""


def triggers(schedule: Schedule, first: int = 0) -> int:
    """Pictures at the mirrors, and rows at the controller, from a slot on; the black ones before it count as well."""
    return len(schedule) - first + PREROLL


class TriggeredPlayer:
    """Plays a schedule on mirrors behind a controller; see `vamgpu.hosts.players.player.Player`.

    pictures: of each projector.  depth: pictures of a sequence of the mirrors, by default `length`.  sequences: of
    them; enough for all pictures make them resident.  policy: decides on late pictures, one for each projector.
    threaded: whether pictures are made and uploaded in threads; by default where time is real.  origin: of a print that
    an earlier host began. Raises `BadInput`.
    """

    def __init__(
        self, schedule: Schedule, machines: Machines, pictures: Sequence[Pictures], *, depth: int | None = None,
        sequences: int = 2, policy: Callable[[Schedule], Underruns] = usual, threaded: bool | None = None,
        origin: Origin | None = None,
    ) -> None:  # fmt: skip
        if len(pictures) != schedule.engines or len(machines.mirrors) != schedule.engines:
            raise BadInput(
                f"the schedule is for {schedule.engines} projectors, the rig has {len(machines.mirrors)} and pictures "
                f"are for {len(pictures)}; choose the rig that the job was made for"
            )
        self.schedule, self.machines, self.clock = schedule, machines, machines.clock
        shows(schedule)
        self.lamp = ControllerLamp(machines.controller, range(schedule.engines), shares=schedule.power[0])
        self.switches: Mapping[str, Switch] = {f"mirrors {k}": Dark(dmd) for k, dmd in enumerate(machines.mirrors)}
        self.renew = Renewal(machines.controller)
        sizes = (each.bits * prod(dmd.plane_shape) for each, dmd in zip(pictures, machines.mirrors, strict=True))
        self._pictures, self._depth = tuple(pictures), (
            length(schedule.rate, max(sizes)) if depth is None else whole("depth", depth)
        )
        self._sequences, self._apart = whole("sequences", sequences, 2), APART + int(schedule.on[0])
        self._threaded = machines.clock.real if threaded is None else threaded
        self._policies = tuple(policy(schedule) for _ in pictures)
        self._orders = [schedule.frame] * schedule.engines
        self._longest = int((schedule.dark - schedule.command).max(where=schedule.command != NONE, initial=0))
        self._origin, self._added = origin, 0
        self._supplies: list[Supply] = []
        self._owed: list[Counter[int]] = [Counter() for _ in pictures]
        self._first = self._kept = self._sent = self._looked = self._before = 0
        self._play: int | None = None

    # ---- before the light ------------------------------------------------------------------------------------
    def prime(self, first: int, alive: Callable[[], None]) -> int:
        """Mirrors and buffers full, the motion at its speed, black pictures and first rows queued."""
        controller = self.machines.controller
        self._first = self._kept = first
        self._still_own(controller.status())
        controller.move(0.0)  # a host that died may have left it running
        self._fill(first, alive)
        controller.mode("steps")
        start = Rows(self.schedule).acts(first) - PREROLL * self._apart
        approach = Approach(self.schedule, controller, self.clock, self.machines.microsteps)
        self._origin = approach.to(start, self._origin or approach.fresh(start), alive)
        code = None if self.machines.lens is None else self.machines.lens.code
        channels = (1 << self.schedule.engines) - 1
        self._rows = Rows(self.schedule, self.machines.microsteps, self._origin.at, code, channels)
        self._motion = Motion(self.schedule, self.machines.microsteps)
        self._ask = Asking(self.clock, controller.status, float(self.schedule.cadence.period) / 8)
        self._sent, self._alive = 0, alive
        self._send(controller.capacity)
        controller.end(triggers(self.schedule, first))
        status = controller.status()
        self._still_own(status)  # all this took its time
        self._before, self._play = status.play, own_number(self.clock, status.play)
        return round(approach.ahead(start, self._origin.at) * SECOND) + PREROLL * self._apart

    def _still_own(self, status: Status) -> None:
        """Raise `DeviceLost` where the controller forgot this print, or played something else."""
        if why := self._forgotten(status):
            raise DeviceLost(why)

    def _forgotten(self, status: Status) -> str | None:
        zero = self._origin is None or status.zero == self._origin.zero
        return None if zero and self._play in (None, status.play) else FORGOTTEN

    def _fill(self, first: int, alive: Callable[[], None]) -> None:
        on = int(self.schedule.on[0]) // 1000
        self._close()
        for engine, (dmd, pictures) in enumerate(zip(self.machines.mirrors, self._pictures, strict=True)):
            dmd.halt()
            dmd.slave()
            timing = SlotTiming(illuminate_us=on)
            stream = PlaneStream(dmd, self._depth, pictures.bits, timing, self._sequences, guard(self.schedule.rate))
            self._supplies.append(
                Supply(stream, pictures, self._orders[engine][first:], self.schedule.pose[first:], self.clock,
                       self.schedule.rate, policy=self._policies[engine], preroll=PREROLL,
                       threaded=self._threaded)
            )  # fmt: skip
        end = self.clock.now() + PRIMING
        while not all(supply.primed for supply in self._supplies):
            for supply in self._supplies:
                supply.prime()
            alive()
            if self.clock.now() > end:
                raise DeviceError(f"mirrors and buffers are not full after {PRIMING // SECOND} s; check their source")
            if not all(supply.primed for supply in self._supplies):
                self.wait()

    def facts(self) -> dict[str, Any]:
        """Where pose 0 is on the motor, and which of the controller's plays the leg is."""
        assert self._origin is not None, "primed"
        own = {"zero": self._origin.zero, "play": self._play, "before": self._before}
        return {"origin": self._origin.at, "preroll": PREROLL} | own

    # ---- in the light ----------------------------------------------------------------------------------------
    def start(self) -> None:
        """Let the controller play its rows."""
        self._looked = self.clock.now()
        assert self._play is not None, "primed"
        self.machines.controller.go(self._play)

    def look(self) -> Look:
        """Compare what the controller triggered with what the mirrors counted."""
        before = [supply.shown() for supply in self._supplies]
        now, status = self._ask()
        after = [supply.shown() for supply in self._supplies]
        count = status.shown if status.play == self._play else 0  # of an earlier play
        counts = (each for low, each in zip(before, after, strict=True) if not low <= count <= each)
        error, pictures = self._motion.error(now, status.position), self._since(count)
        self._looked, self._free = now, status.free
        return Look(
            status.state == "running", error, next(counts, count), count, pictures,
            status.position / self.machines.microsteps - self._rows.origin,
            min(supply.share for supply in self._supplies),
            min(supply.ahead for supply in self._supplies) / self.schedule.rate, self._fault(status),
        )  # fmt: skip

    def _fault(self, status: Status) -> str | None:
        """Why the controller cannot be trusted."""
        if status.state == "fault":
            return f"the controller closed the light: {status.fault}"
        if why := self._forgotten(status):
            return why
        if status.late:
            return f"{status.late} rows came to the controller after their time; look at what holds up the host"
        if status.state == "running" and status.shown < triggers(self.schedule, self._first):
            speed = float(self.schedule.speed) * self.machines.microsteps
            overdue = (status.position - self._row(status.shown).at) / speed - self._longest * 1e-9
            if overdue > PATIENCE:
                return f"no trigger for {1e3 * overdue:.0f} ms after picture {status.shown}, though the motion is there"
        return None

    def _since(self, shown: int) -> tuple[Shown, ...]:
        """The pictures shown since the last look.

        How late one was, is told as at most: from the last look before its trigger to when it was at the mirrors.
        """
        first, table, found = self._first, self.schedule, []
        stop = max(self._kept, min(first + shown - PREROLL, len(table)))
        for slot in range(self._kept, stop):
            for engine, supply in enumerate(self._supplies):
                frame, dark = int(self._orders[engine][slot]), supply.black(slot - first)
                on = 0 if frame == NONE else int(table.on[slot])
                found.append(
                    Shown(slot, frame, int(table.pose[slot]), int(table.light[slot]), on,
                          late=supply.arrived(slot - first) - self._looked, engine=engine, dark=dark)
                )  # fmt: skip
        self._kept = stop
        return tuple(found)

    def feed(self) -> None:
        """Black for what is late, and rows onward."""
        for supply in self._supplies:
            supply.fill()
        self._send(self._free)

    def _send(self, free: int) -> None:
        """Send rows while there is room: the black pictures before the first slot, then slots."""
        stop = min(self._sent + free, triggers(self.schedule, self._first))
        for number in range(self._sent, stop):
            self.machines.controller.row(self._row(number))
            if number % 16 == 15:  # a slow line takes a while
                self._alive()
        self._sent = max(self._sent, stop)

    def _row(self, number: int) -> Row:
        """A row of this leg."""
        if number < PREROLL:
            return self._rows.dark(self._first, (PREROLL - number) * self._apart, number)
        return self._rows.row(self._first + number - PREROLL, number)

    def wait(self) -> None:
        """Return when the next look is due."""
        self.clock.sleep_until(self.clock.now() + LOOK)

    # ---- after the light -------------------------------------------------------------------------------------
    def finish(self) -> None:
        """End after the picture on its way, so that none is cut."""
        controller = self.machines.controller
        controller.end(min(controller.status().shown + 1, triggers(self.schedule, self._first)))

    def halt(self) -> None:
        """The motion to rest, rows dropped, mirrors dark; each whatever the one before it did."""
        if failed := insist(self.machines.controller.stop, self._close):
            raise failed[0]

    def _close(self) -> None:
        supplies, self._supplies = self._supplies, []
        with ExitStack() as stack:
            for supply in supplies:
                stack.callback(supply.close)
                stack.callback(supply.take_back, self._kept - self._first)

    def amends(self) -> bool:
        """Add a turn that shows again what was missed. Raises `Underrun` after `TURNS` of them."""
        for owed, policy in zip(self._owed, self._policies, strict=True):
            owed += policy.owes()
        if not any(self._owed):
            return False
        if self._added == TURNS:
            missed = max(each.total() for each in self._owed)
            raise Underrun(f"{missed} pictures were not shown in {TURNS} added turns; make them faster, or turn slower")
        self._added += 1
        self.schedule = self.schedule.turned_again(set().union(*self._owed))
        turn = self.schedule.frame[-self.schedule.frames :]
        for engine, owed in enumerate(self._owed):
            frames = np.where(np.isin(turn, list(owed)), turn, NONE)
            self._orders[engine] = np.concatenate([self._orders[engine], frames])
            owed -= Counter(list(owed))  # once each
        return True

    def recall(self, lost: Sequence[Sequence[int]]) -> None:
        """Poses that were black under an earlier host, of each projector."""
        for policy, poses in zip(self._policies, lost, strict=True):
            for pose in poses:
                policy.lost(pose)

    def picture(self, number: int) -> np.ndarray:
        """A frame of the first projector for people."""
        return self._pictures[0].picture(number)

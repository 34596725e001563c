"""Plays a schedule on triggered mirrors: a controller moves, triggers and gates the light row by row, on its own.

The mirrors show the next frame at each trigger, so what is shown follows from how many triggers were counted, never
from a host's time; this side keeps frames and rows ahead of the counter, and compares both counts.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from math import prod
from typing import Any

import numpy as np

from vamgpu.errors import BadInput, DeviceError, OriginLost, Underrun
from vamgpu.hosts.clock import Clock, TimedQuery
from vamgpu.hosts.drivers.dmd import SlotTiming
from vamgpu.hosts.drivers.memory import MirrorMemory
from vamgpu.hosts.frames.late import LatePolicy
from vamgpu.hosts.frames.packer import packer
from vamgpu.hosts.frames.sources import FrameSource
from vamgpu.hosts.frames.upload import BUFFERS, UploadQueue, guard, length
from vamgpu.hosts.frames.versions import Boundaries, FramePlans, FrameVersion
from vamgpu.hosts.players.approach import POLL, Approach, Origin, SpeedMonitor, own_number
from vamgpu.hosts.players.machines import MirrorBlackout, MirrorMachines, late_policy, shows
from vamgpu.hosts.players.player import Renew, StatusPoll
from vamgpu.hosts.protocols.controller import ControllerRow, Status
from vamgpu.hosts.record import FrameRecord
from vamgpu.hosts.run_all import run_all
from vamgpu.hosts.safety.light import Lamp, LampGate, Switch
from vamgpu.hosts.schedules.rows import RowTable
from vamgpu.hosts.schedules.schedule import NONE, Schedule
from vamgpu.hosts.schedules.timing import SECOND, whole

PRIMING = 60 * SECOND  # longest wait for mirrors and buffers to be full before the light opens [ns]
PREROLL = 2
"""Black frames that are triggered before the first slot: some mirrors show an unpredictable first frame, and both
counts must agree before there is light."""
APART = SECOND // 7  # least time between them, and to the first slot [ns]: some polls
PATIENCE = 0.25  # how long a trigger may be overdue [s], by where the motion is
FORGOTTEN = (
    "the controller has another zero or play than this print: it lost its power, was reset, or served another program, "
    "so nobody knows where the motor is and what the resin saw; begin anew with fresh resin"
)
CLOSED = {
    "stall": "stall, the encoder is not where the motor was stepped to; look at motor and load",
    "index": "index, its mark was not where it should be: the motor lost steps, or the belt slipped",
}
TURNS = 2  # most turns of a vial that are added for what was missed


def triggers(schedule: Schedule, first: int = 0) -> int:
    """Frames at the mirrors, and rows at the controller, from a slot on; the black ones before it count as well."""
    return len(schedule) - first + PREROLL


class TriggeredPlayer:
    """Plays a schedule on mirrors behind a controller; see `vamgpu.hosts.players.player.Player`.

    sources: of each projector.  depth: frames of a sequence of the mirrors, by default `length`.  sequences: of
    them; enough for all frames make them resident.  turn: slots of a vial that fit into them together, and are then
    uploaded once however often they come round.  policy: decides on late frames, one for each projector.
    threaded: whether frames are made and uploaded in threads; by default where time is real.  origin: of a print that
    an earlier host began.  plans: versions of the frames, on the sources. Raises `BadInput`.
    """

    schedule: Schedule
    machines: MirrorMachines
    clock: Clock
    lamp: Lamp
    renew: Renew

    def __init__(
        self, schedule: Schedule, machines: MirrorMachines, sources: Sequence[FrameSource], *, depth: int | None = None,
        sequences: int = 2, turn: int | None = None, policy: Callable[[Schedule], LatePolicy] = late_policy,
        threaded: bool | None = None, origin: Origin | None = None, plans: FramePlans | None = None,
    ) -> None:  # fmt: skip
        if len(sources) != schedule.engines or len(machines.mirrors) != schedule.engines:
            raise BadInput(
                f"the schedule is for {schedule.engines} projectors, the rig has {len(machines.mirrors)} and frames "
                f"are for {len(sources)}; choose the rig that the job was made for"
            )
        self.schedule, self.machines, self.clock = schedule, machines, machines.clock
        shows(schedule)
        self.lamp, self.renew = self._gate(machines)
        self.switches: Mapping[str, Switch] = {
            f"mirrors {k}": MirrorBlackout(dmd) for k, dmd in enumerate(machines.mirrors)
        }
        sizes = (each.bits * prod(dmd.plane_shape) for each, dmd in zip(sources, machines.mirrors, strict=True))
        self.plans: FramePlans | None = plans
        self._sources: tuple[FrameSource, ...] = tuple(sources) if plans is None else plans.sources
        self._missed: list[dict[int, list[int]]] = [{} for _ in sources]  # versions of frames that were black
        self.owed: set[int] = set()
        self._depth = length(schedule.rate, max(sizes)) if depth is None else whole("depth", depth)
        self._sequences, self._apart = whole("sequences", sequences, 2), APART + int(schedule.on[0])
        self._turn = turn
        self._threaded = machines.clock.real if threaded is None else threaded
        self._policies = tuple(policy(schedule) for _ in sources)
        self._orders = [schedule.frame if plans is None else plans.order(schedule.frame)] * schedule.engines
        self._longest = int((schedule.dark - schedule.command).max(where=schedule.command != NONE, initial=0))
        self._origin, self._added = origin, 0
        self._queues: list[UploadQueue] = []
        self._pending: list[Counter[int]] = [Counter() for _ in sources]
        self._first = self._kept = self._punctual = self._sent = self._polled = self._before = 0
        self._play: int | None = None
        self._lost: float | None = None
        self._preroll = PREROLL
        self._going = False
        self._blind: tuple[int, int] | None = None  # frames that the mirrors counted, then silence of the line [ns]

    def _gate(self, machines: MirrorMachines) -> tuple[Lamp, Renew]:
        """The light, and what renews its lease."""
        gate = LampGate(machines.controller, range(self.schedule.engines), shares=self.schedule.power[0])
        return gate, gate.renew

    # ---- before the light ------------------------------------------------------------------------------------
    def prime(self, first: int, alive: Callable[[], None]) -> int:
        """Mirrors and buffers full, the motion at its speed, black frames and first rows queued."""
        controller = self.machines.controller
        self._first = self._kept = self._punctual = first
        self._blind = None
        self._still_own(controller.status())
        controller.move(0.0)  # a host that died may have left it running
        self._fill(first, alive)
        controller.mode("steps")
        start = RowTable(self.schedule).acts(first) - PREROLL * self._apart
        approach = Approach(self.schedule, controller, self.clock, self.machines.microsteps)
        self._origin = (
            approach.fresh(start, alive) if self._origin is None else approach.again(start, self._origin, alive)
        )
        self._lost = approach.lost
        self._origin = approach.to(start, self._origin, alive)
        code = None if self.machines.lens is None else self.machines.lens.code
        channels = (1 << self.schedule.engines) - 1
        self._rows = RowTable(self.schedule, self.machines.microsteps, self._origin.at, code, channels)
        self._motion = SpeedMonitor(self.schedule, self.machines.microsteps)
        self._ask = TimedQuery(self.clock, controller.status, float(self.schedule.cadence.period) / 8)
        self._sent, self._alive = 0, alive
        self._send(controller.capacity)
        controller.end(triggers(self.schedule, first))
        status = controller.status()
        self._still_own(status)  # all this took its time
        self._before, self._play, self._going = status.play, own_number(self.clock, status.play), False
        return round(approach.ahead(start, self._origin.at) * SECOND) + PREROLL * self._apart

    def _still_own(self, status: Status) -> None:
        """Raise `OriginLost` where the controller forgot this print, or played something else."""
        if why := self._forgotten(status):
            raise OriginLost(why)

    def _forgotten(self, status: Status) -> str | None:
        zero = self._origin is None or status.zero == self._origin.zero
        plays = (self._play,) if self._going else (self._play, self._before)  # one that was primed may never begin
        return None if zero and (self._play is None or status.play in plays) else FORGOTTEN

    def _fill(self, first: int, alive: Callable[[], None]) -> None:
        on = int(self.schedule.on[0]) // 1000
        self._close()
        for engine, (dmd, source) in enumerate(zip(self.machines.mirrors, self._sources, strict=True)):
            dmd.halt()
            dmd.slave()
            timing = SlotTiming(illuminate_us=on)
            ahead, order = guard(self.schedule.rate), self._orders[engine][first:]
            memory = MirrorMemory(dmd, self._depth, source.bits, timing, self._sequences, ahead)
            packed = packer(source, (source.bits, *dmd.plane_shape), int(order.max(initial=0)) + 1, self._depth)
            queue = UploadQueue(
                packed, order, memory, self.clock, batch=self._depth, depth=BUFFERS, guard=ahead,
                preroll=self._preroll, poses=self.schedule.pose[first:], policy=self._policies[engine],
                turn=self._turn, boundaries=self._boundaries(ahead),
            )  # fmt: skip
            self._queues.append(queue)
            if self._threaded:
                queue.start()
        end = self.clock.now() + PRIMING
        while not all(queue.primed for queue in self._queues):
            for queue in self._queues:
                queue.prime()
            alive()
            if self.clock.now() > end:
                raise DeviceError(f"mirrors and buffers are not full after {PRIMING // SECOND} s; check their source")
            if not all(queue.primed for queue in self._queues):
                self.wait()

    def _boundaries(self, guard: int) -> Boundaries | None:
        """Where frames may be replaced: a sequence of the mirrors is filled while the one before it is shown."""
        return None if self.plans is None else Boundaries(self.plans.count, self._first, guard + self._depth)

    def facts(self) -> dict[str, Any]:
        """Where pose 0 is on the motor, and which of the controller's plays the run segment is."""
        assert self._origin is not None, "primed"
        own = {"zero": self._origin.zero, "play": self._play, "before": self._before}
        lost = {} if self._lost is None else {"lost": self._lost}
        return {"origin": self._origin.at, "preroll": PREROLL} | own | lost

    # ---- in the light ----------------------------------------------------------------------------------------
    def start(self) -> None:
        """Let the controller play its rows."""
        self._polled = self.clock.now()
        assert self._play is not None, "primed"
        self.machines.controller.go(self._play)
        self._going = True

    def poll(self) -> StatusPoll:
        """Compare what the controller triggered with what the mirrors counted."""
        before = [queue.shown() for queue in self._queues]
        began = self.clock.now()
        try:
            now, status = self._ask()
        except DeviceError:
            self._blind = self._blind or (max(before), self.clock.now() - began)
            raise
        after = [queue.shown() for queue in self._queues]
        count = status.shown if status.play == self._play else 0  # of an earlier play
        counts = (each for low, each in zip(before, after, strict=True) if not low <= count <= each)
        error, frames = self._motion.error(now, status.at), self._since(count)
        if not status.late:
            self._punctual = self._kept
        self._polled, self._free = now, status.free
        return StatusPoll(
            status.state == "running", error, next(counts, count), count, frames,
            status.at / self.machines.microsteps - self._rows.origin,
            min(queue.share for queue in self._queues),
            min(queue.ahead for queue in self._queues) / self.schedule.rate, self._fault(status),
            self._forgotten(status) is not None,
        )  # fmt: skip

    def _fault(self, status: Status) -> str | None:
        """Why the controller cannot be trusted."""
        if status.state == "fault":
            return f"the controller closed the light: {CLOSED.get(status.fault, status.fault)}"
        if why := self._forgotten(status):
            return why
        if status.late:
            return f"{status.late} rows came to the controller after their time; look at what holds up the host"
        if status.state == "running" and status.shown < triggers(self.schedule, self._first):
            speed = float(self.schedule.speed) * self.machines.microsteps
            overdue = (status.position - self._row(status.shown).at) / speed - self._longest * 1e-9
            if overdue > PATIENCE:
                return f"no trigger for {1e3 * overdue:.0f} ms after frame {status.shown}, though the motion is there"
        return None

    def _since(self, shown: int) -> tuple[FrameRecord, ...]:
        """The frames shown since the last poll.

        How late one was, is told as at most: from the last poll before its trigger to when it was at the mirrors.
        """
        first, table, found = self._first, self.schedule, []
        stop = max(self._kept, min(first + shown - self._preroll, len(table)))
        for slot in range(self._kept, stop):
            for engine, queue in enumerate(self._queues):
                number, dark = int(self._orders[engine][slot]), queue.was_black(slot - first)
                version, frame = (0, number) if self.plans is None else self.plans.told_apart(number)
                if dark and frame != NONE and table.unit == "deg":
                    self._miss(engine, frame, version)
                on = 0 if frame == NONE else int(table.on[slot])
                found.append(
                    FrameRecord(slot, frame, int(table.pose[slot]), int(table.light[slot]), on,
                          late=queue.arrival(slot - first) - self._polled, engine=engine, dark=dark,
                          version=version)
                )  # fmt: skip
        self._kept = stop
        return tuple(found)

    def feed(self) -> None:
        """Black for what is late, and rows onward."""
        for queue in self._queues:
            queue.feed()
        self._send(self._free)

    def swap(self, version: FrameVersion) -> bool:
        """Show a version from its turn on, on all projectors or on none."""
        assert self.plans is not None, "with plans"
        begin = version.turn * self.plans.count
        if begin < self._kept:
            return False
        with ExitStack() as held:
            if not all([held.enter_context(queue.replaceable(begin - self._first)) for queue in self._queues]):
                return False
            self.plans.commit(version)
            planned = self.plans.order(self.schedule.frame)[: self.plans.slots]
            self._orders = [np.concatenate([planned, order[len(planned) :]]) for order in self._orders]
            for queue, order in zip(self._queues, self._orders, strict=False):
                queue.replace(begin - self._first, order[begin:])
            return True

    def _send(self, free: int) -> None:
        """Send rows while there is room: the black frames before the first slot, then slots."""
        stop = min(self._sent + free, triggers(self.schedule, self._first))
        for number in range(self._sent, stop):
            self.machines.controller.row(self._row(number))
            if number % 16 == 15:  # a slow line takes a while
                self._alive()
        self._sent = max(self._sent, stop)

    def _row(self, number: int) -> ControllerRow:
        """A row of this run segment."""
        if number < PREROLL:
            return self._rows.dark(self._first, (PREROLL - number) * self._apart, number)
        return self._rows.row(self._first + number - PREROLL, number)

    def wait(self) -> None:
        """Return when the next poll is due."""
        self.clock.sleep_until(self.clock.now() + POLL)

    # ---- after the light -------------------------------------------------------------------------------------
    def finish(self) -> None:
        """End after the frame on its way, so that none is cut."""
        controller = self.machines.controller
        controller.end(min(controller.status().shown + 1, triggers(self.schedule, self._first)))

    def doubtful(self) -> range:
        """The frame on show; those since rows came late; with a dead line what may have been triggered.

        Once the controller has closed the light it triggers nothing more.
        """
        sure = min(self._kept, self._punctual)
        self._kept = max(self._kept, min(self._first + self._triggered() - self._preroll, len(self.schedule)))
        return range(max(sure - 1, self._first), self._kept)

    def _triggered(self) -> int:
        """Frames of this run segment, in the dark; at most, where the controller does not answer."""
        try:
            status = self.machines.controller.status()
        except DeviceError:
            if self._blind is None:
                raise
            counted, time = self._blind
            return counted + 1 + time // self.schedule.gap
        return status.shown if status.play == self._play else 0

    def recover(self) -> None:
        """Reach the controller again, and drop rows that it could not be told to."""
        self.machines.controller.revive()
        self.machines.controller.stop()

    def halt(self) -> None:
        """The motion to rest, rows dropped, mirrors dark; each whatever the one before it did."""
        if failed := run_all(self.machines.controller.stop, self._close):
            raise failed[0]

    def _close(self) -> None:
        queues, self._queues = self._queues, []
        with ExitStack() as stack:
            for queue in queues:
                stack.callback(queue.close)
                stack.callback(queue.undo_drops, self._kept - self._first)

    def add_repeats(self) -> bool:
        """Add a turn that shows again what was missed. Raises `Underrun` after `TURNS` of them."""
        for pending, policy in zip(self._pending, self._policies, strict=True):
            pending += policy.pending_repeats()
        if not any(self._pending):
            return False
        if self._added == TURNS:
            missed = max(each.total() for each in self._pending)
            raise Underrun(f"{missed} frames were not shown in {TURNS} added turns; make them faster, or turn slower")
        self._added += 1
        self.schedule = self.schedule.turned_again(set().union(*self._pending))
        turn = self.schedule.frame[-self.schedule.frames :]
        for engine, pending in enumerate(self._pending):
            frames = np.where(np.isin(turn, list(pending)), turn, NONE)
            if self.plans is not None:
                last = self.plans.at(len(self.schedule))
                owed = [(self._missed[engine].get(frame) or [last]).pop(0) for frame in frames.tolist()]
                frames = np.where(frames == NONE, NONE, frames + self.plans.frames * np.array(owed))
            self._orders[engine] = np.concatenate([self._orders[engine], frames])
            pending -= Counter(list(pending))  # once each
        return True

    def recall(self, lost: Sequence[Sequence[int]]) -> None:
        """Poses that were black under an earlier host, of each projector."""
        for engine, (policy, poses) in enumerate(zip(self._policies, lost, strict=True)):
            for pose in poses:
                policy.drop(pose)
                if self.plans is not None and self.plans.unit == "turn":
                    self._miss(engine, pose % self.plans.count, self.plans.at(pose))

    def _miss(self, engine: int, frame: int, version: int) -> None:
        """Keep in mind which version owes a frame that comes round again."""
        self._missed[engine].setdefault(frame, []).append(version)
        self.owed.add(version)

    def frame(self, number: int, engine: int = 0) -> np.ndarray:
        """A projector's frame for people."""
        version = 0 if self.plans is None else self.plans.at(self._kept) * self.plans.frames
        return self._sources[engine].frame(number + version)

"""Plays a schedule on mirrors that show and count a frame at each trigger: the host's timing does not matter."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from math import prod
from typing import Generic, TypeVar

import numpy as np

from vamgpu.errors import BadInput, DeviceError, Underrun
from vamgpu.hosts.drivers.dmd import SlotTiming
from vamgpu.hosts.drivers.memory import MirrorMemory
from vamgpu.hosts.frames.lateness import Repeats
from vamgpu.hosts.frames.packer import packer
from vamgpu.hosts.frames.sources import FrameSource
from vamgpu.hosts.frames.upload import BUFFERS, UploadQueue, guard, length
from vamgpu.hosts.frames.versions import Boundaries, FrameVersion, FrameVersions
from vamgpu.hosts.player.machines import MirrorMachines, StageMachines, late_policy, recover, shows
from vamgpu.hosts.player.motor import POLL
from vamgpu.hosts.player.player import Renew
from vamgpu.hosts.records.record import FrameRecord
from vamgpu.hosts.safety.light import Lamp, Switch
from vamgpu.hosts.schedules.clock import Clock
from vamgpu.hosts.schedules.schedule import NONE, Schedule
from vamgpu.hosts.schedules.timing import SECOND, whole

PRIMING = 60 * SECOND  # longest wait for full mirrors and buffers before the light opens [ns]
TURNS = 2  # most turns added to a vial for missed frames
M = TypeVar("M", MirrorMachines, StageMachines)


class MirrorPlayer(ABC, Generic[M]):
    """Frames, versions and repeats of a `Player` on mirrors; subclasses move and trigger."""

    lamp: Lamp
    renew: Renew

    def __init__(
        self, schedule: Schedule, machines: M, sources: Sequence[FrameSource], *, depth: int | None = None,
        sequences: int = 2, turn: int | None = None,
        threaded: bool | None = None, versions: FrameVersions | None = None, preroll: int = 0,
    ) -> None:  # fmt: skip
        if len(sources) != schedule.engines or len(machines.mirrors) != schedule.engines:
            raise BadInput(
                f"the schedule is for {schedule.engines} projectors, the rig has {len(machines.mirrors)} and frames "
                f"are for {len(sources)}; choose the rig of the job"
            )
        self.schedule: Schedule = schedule
        self.machines = machines
        self.clock: Clock = machines.clock
        shows(schedule)
        self.lamp, self.renew = self._gate()
        self.switches: Mapping[str, Switch] = {f"mirrors {k}": dmd for k, dmd in enumerate(machines.mirrors)}
        sizes = (each.bits * prod(dmd.plane_shape) for each, dmd in zip(sources, machines.mirrors, strict=True))
        self.versions: FrameVersions | None = versions
        self._sources: tuple[FrameSource, ...] = tuple(sources) if versions is None else versions.sources
        self._missed = tuple(Repeats(late_policy(schedule)) for _ in sources)
        self._depth = length(schedule.rate, max(sizes)) if depth is None else whole("depth", depth)
        self._sequences, self._turn = whole("sequences", sequences, 2), turn
        self._threaded = machines.clock.real if threaded is None else threaded
        self._orders = [schedule.frame if versions is None else versions.order(schedule.frame)] * schedule.engines
        self._queues: list[UploadQueue] = []
        self._first = self._kept = self._punctual = self._polled = self._added = 0
        self._preroll = preroll

    @abstractmethod
    def _gate(self) -> tuple[Lamp, Renew]:
        """The light, and the renewal of its lease."""

    @abstractmethod
    def _triggered(self) -> int:
        """Frames of this run segment that may have been triggered, in the dark."""

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
                preroll=self._preroll, poses=self.schedule.pose[first:], policy=self._missed[engine].policy,
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
        """Boundaries for versions: a sequence of the mirrors is filled while the one before it is shown."""
        return None if self.versions is None else Boundaries(self.versions.count, self._first, guard + self._depth)

    def _since(self, shown: int) -> tuple[FrameRecord, ...]:
        """The frames shown since the last poll; their lateness is an upper bound."""
        first, table, found = self._first, self.schedule, []
        stop = max(self._kept, min(first + shown - self._preroll, len(table)))
        for slot in range(self._kept, stop):
            for engine, queue in enumerate(self._queues):
                number, dark = int(self._orders[engine][slot]), queue.was_black(slot - first)
                version, frame = (0, number) if self.versions is None else self.versions.split_number(number)
                if dark and frame != NONE and table.repeats:
                    self._missed[engine].miss(frame, version)
                on = 0 if frame == NONE else int(table.on[slot])
                found.append(
                    FrameRecord(slot, frame, int(table.pose[slot]), int(table.light[slot]), on,
                          late=queue.arrival(slot - first) - self._polled, engine=engine, dark=dark,
                          version=version)
                )  # fmt: skip
        self._kept = stop
        return tuple(found)

    def swap(self, version: FrameVersion) -> bool:
        """Show a version from its turn on, on all projectors or on none."""
        assert self.versions is not None, "with versions"
        begin = version.turn * self.versions.count
        if begin < self._kept:
            return False
        with ExitStack() as held:
            if not all([held.enter_context(queue.replaceable(begin - self._first)) for queue in self._queues]):
                return False
            self.versions.commit(version)
            planned = self.versions.order(self.schedule.frame)[: self.versions.slots]
            self._orders = [np.concatenate([planned, order[len(planned) :]]) for order in self._orders]
            for queue, order in zip(self._queues, self._orders, strict=False):
                queue.replace(begin - self._first, order[begin:])
            return True

    def _counted(self) -> list[int]:
        """Frames shown by the mirrors of each projector, with the black ones before the first slot."""
        return [queue.shown() for queue in self._queues]

    def _supply(self) -> tuple[float, float]:
        """Fill level of the buffers, 0..1, and duration of the frames at the mirrors [s]."""
        ahead = min(queue.ahead for queue in self._queues)
        return min(queue.share for queue in self._queues), ahead / self.schedule.rate

    def feed(self) -> None:
        """Replace late frames by black."""
        for queue in self._queues:
            queue.feed()

    def wait(self) -> None:
        self.clock.sleep_until(self.clock.now() + POLL)

    @property
    def pending_versions(self) -> set[int]:
        return set().union(*(each.missed for each in self._missed))

    def doubtful(self) -> range:
        """The present frame, frames since rows were late, and with a dead line all that may have been triggered."""
        sure = min(self._kept, self._punctual)
        self._kept = max(self._kept, min(self._first + self._triggered() - self._preroll, len(self.schedule)))
        return range(max(sure - 1, self._first), self._kept)

    def recover(self) -> None:
        """Reconnect to controller and lens."""
        recover(self.machines)

    def _close(self) -> None:
        queues, self._queues = self._queues, []
        with ExitStack() as stack:
            for queue in queues:
                stack.callback(queue.close)
                stack.callback(queue.undo_drops, self._kept - self._first)

    def add_repeats(self) -> bool:
        """Add a turn with the missed frames. Raises `Underrun` after `TURNS` of them."""
        due = [each.collect() for each in self._missed]
        if not any(due):
            return False
        if self._added == TURNS:
            missed = max(each.total() for each in due)
            raise Underrun(f"{missed} frames were not shown in {TURNS} added turns; make them faster, or turn slower")
        self._added += 1
        self.schedule = self.schedule.turned_again(set().union(*due))
        turn = self.schedule.frame[-self.schedule.frames :]
        for engine, repeats in enumerate(self._missed):
            frames = np.where(np.isin(turn, list(due[engine])), turn, NONE)
            if self.versions is not None:
                last = self.versions.at(len(self.schedule))
                versions = np.array([repeats.version(frame, last) for frame in frames.tolist()])
                frames = np.where(frames == NONE, NONE, frames + self.versions.frames * versions)
            self._orders[engine] = np.concatenate([self._orders[engine], frames])
            repeats.added()
        return True

    def repeat(self, slots: range) -> None:
        for slot in slots:
            for engine, repeats in enumerate(self._missed):
                number = int(self._orders[engine][slot])
                version, frame = (0, number) if self.versions is None else self.versions.split_number(number)
                if frame != NONE:
                    repeats.policy.drop(frame)
                    repeats.miss(frame, version)

    def restore(self, lost: Sequence[Sequence[int]]) -> None:
        """Poses of each projector that were black under an earlier host."""
        for repeats, poses in zip(self._missed, lost, strict=True):
            for pose in poses:
                repeats.policy.drop(pose)
                if self.versions is not None and self.versions.unit == "turn":
                    repeats.miss(pose % self.versions.count, self.versions.at(pose))

    def frame(self, number: int, engine: int = 0) -> np.ndarray:
        version = 0 if self.versions is None else self.versions.at(self._kept) * self.versions.frames
        return self._sources[engine].frame(number + version)

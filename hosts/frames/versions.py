"""Versions of frames: frames of coming turns of a vial, or segments of a web, may be replaced at their start.

In a queue frame ``n`` of version ``v`` is number ``v * frames + n``. A version that comes too late is dropped.
"""

from __future__ import annotations

import threading
from bisect import bisect_right
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.geometry import positive
from vamgpu.hosts.frames.packer import DevicePacker, PlanePacker
from vamgpu.hosts.frames.sources import FrameSource
from vamgpu.hosts.schedules.schedule import NONE
from vamgpu.hosts.schedules.timing import whole

ROUNDING = 1e-6  # share of light that counts as rounding


@dataclass(frozen=True)
class Boundaries:
    """Boundaries at which the frames of a queue may be replaced: starts of turns of a vial, or of segments of a web."""

    turn: int  # slots per turn or segment
    first: int  # first slot of the queue in the print
    lead: int  # slots before a boundary from which frames beyond it may be packed

    def horizon(self, slot: int) -> int:
        """The slot up to which frames may be packed, given the next slot to be shown."""
        return ((max(slot, self.first) + self.lead) // self.turn + 1) * self.turn


@dataclass(frozen=True, eq=False)
class FrameVersion:
    """Frames from the start of a turn of a vial, or of a segment of a web."""

    number: int  # 1, 2, …; 0 is the job's
    sources: tuple[FrameSource, ...]  # frames of each projector
    turn: int  # the first turn, or segment, that shows it
    stop: int | None = None  # the turn before which the light ends; None: no end
    light: float = 1.0  # light of a turn, relative to that of the job's frames
    until: int | None = None  # the turn from which the earlier frames are shown again; None: never

    def facts(self) -> dict[str, Any]:
        """The version as stored in a run's folder, beside its frames."""
        told = {"version": self.number, "turn": self.turn, "stop": self.stop, "light": self.light}
        return told if self.until is None else told | {"until": self.until}


class FrameVersions:
    """The versions of a print's frames. Any thread may `swap`; the printing thread commits or drops the offered one."""

    def __init__(
        self, sources: Sequence[FrameSource], count: int, turns: int, *, allowance: float = 0.0,
        unit: Literal["turn", "segment"] = "turn", slots: int | None = None,
    ) -> None:  # fmt: skip
        self.count: int = whole("count", count)
        self.turns: int = whole("turns", turns)
        self.unit: str = unit
        self.slots: int = self.count * self.turns if slots is None else whole("slots", slots)
        self.frames: int = self.count if unit == "turn" else self.slots  # in the numbers of a version
        self.allowance: float = positive("allowance of light", allowance, zero=True)
        self._lock = threading.Lock()
        self._versions = {0: FrameVersion(0, tuple(sources), 0)}
        self._light = {0: 1.0}
        self._table = [(0, 0)]  # first slots of committed versions, rising, and their numbers
        self._offered: FrameVersion | None = None
        self._refused: list[tuple[int, str]] = []
        self.last: int = 0
        self.stop: int | None = None
        self.sources: tuple[VersionedFrames, ...] = tuple(VersionedFrames(self, k) for k in range(len(sources)))

    def swap(
        self, sources: Sequence[FrameSource], turn: int, *, light: float = 1.0, stop: int | None = None,
        number: int | None = None, until: int | None = None,
    ) -> int:  # fmt: skip
        """Offer frames from a turn or segment on; returns their version. Raises `BadInput`, see `check`."""
        job = self._versions[0].sources
        if len(sources) != len(job) or any(new.bits != old.bits for new, old in zip(sources, job, strict=True)):
            raise BadInput(
                f"got frames of {[each.bits for each in sources]} bits; expected {[each.bits for each in job]}, one "
                "for each projector of the job: pack them like its own"
            )
        light = self.check(turn, light, stop, until)
        with self._lock:
            version = FrameVersion(
                self.last + 1 if number is None else number, tuple(sources), turn, stop, light, until
            )
            if version.number <= self.last:
                raise BadInput(f"got version {version.number} after version {self.last}; expected a greater number")
            for source in self.sources:
                source.prepare(version)
            self.last = version.number
            if self._offered is not None:
                self._refuse(self._offered, f"version {version.number} came before it was shown")
            self._offered = self._versions[version.number] = version
        return version.number

    def check(self, turn: int, light: float, stop: int | None = None, until: int | None = None) -> float:
        """Raise `BadInput` for a version of another print, or with too much light; see `swap`."""
        ends = [end for end in (stop, until) if end is not None]
        if not 0 < whole(self.unit, turn, 0) < self.turns or not all(turn < end <= self.turns for end in ends):
            raise BadInput(
                f"got {self.unit}s {turn} to {stop if until is None else until} of {self.turns}; expected a first "
                f"{self.unit} from 1 on, and an end after it"
            )
        light = positive("light of a version", light, zero=True)
        if self.unit == "segment":
            if light > (1 + self.allowance) * (1 + ROUNDING):
                raise BadInput(
                    f"the version has {light:.4g} times the light of the segments that it replaces; "
                    f"{1 + self.allowance:.4g} are allowed: allow more light"
                )
            return light
        with self._lock:
            before = sum(self._light[self.at(earlier * self.count)] for earlier in range(turn))
            after = sum(self._light[self.at(later * self.count)] for later in range(until or self.turns, self.turns))
        total = before + light * (min(stop or self.turns, until or self.turns) - turn) + after
        most = self.turns * (1 + self.allowance)
        if total > most * (1 + ROUNDING):
            raise BadInput(
                f"the print would have {total:.4g} times the light of a turn; {most:.4g} are allowed: allow more "
                "light, or end sooner"
            )
        return light

    def at(self, slot: int) -> int:
        """The version of a slot, as decided so far."""
        return self._table[bisect_right(self._table, (slot, self.last)) - 1][1]

    def source(self, number: int, engine: int) -> FrameSource:
        """Frames of a version. Raises `BadInput` if they are no longer stored."""
        version = self._versions.get(number)
        if version is None:
            raise BadInput(f"the frames of version {number} are not stored; there are {sorted(self._versions)}")
        return version.sources[engine]

    @property
    def end(self) -> int:
        """The slot before which the light ends, without added turns."""
        return min((self.stop or self.turns) * self.count, self.slots)

    def facts(self) -> dict[str, Any]:
        """The boundaries of versions, as stored in a run's folder with each swap."""
        told: dict[str, Any] = {"turns": self.turns}
        return told if self.unit == "turn" else told | {"unit": self.unit, "count": self.count}

    def take(self) -> FrameVersion | None:
        """The version offered last, which is now committed or dropped."""
        with self._lock:
            taken, self._offered = self._offered, None
            return taken

    def commit(self, version: FrameVersion) -> None:
        """Show a version in the slots from its turn on."""
        with self._lock:
            begin, rest = version.turn * self.count, []
            if version.until is not None and (end := version.until * self.count) < self.slots:
                rest = [(end, self.at(end)), *(row for row in self._table if row[0] > end)]
            self._table = [row for row in self._table if row[0] < begin] + [(begin, version.number), *rest]
            self._light[version.number], self.stop = version.light, version.stop

    def drop(self, version: FrameVersion, why: str) -> None:
        with self._lock:
            self._refuse(version, why)

    def _refuse(self, version: FrameVersion, why: str) -> None:
        self._refused.append((version.number, why))
        self._versions.pop(version.number, None)

    def refused(self) -> list[tuple[int, str]]:
        """Versions dropped since the last call, and why."""
        with self._lock:
            told, self._refused = self._refused, []
        return told

    def restore(self, version: FrameVersion) -> None:
        """Restore a version that an earlier host committed."""
        with self._lock:
            self._versions[version.number], self.last = version, max(self.last, version.number)
        self.commit(version)

    def supply(self, number: int, sources: Sequence[FrameSource]) -> None:
        """Set the frames of a version that was restored without them."""
        with self._lock:
            self._versions[number] = replace(self._versions[number], sources=tuple(sources))

    def forget(self, slot: int, missed: Collection[int] = ()) -> None:
        """Drop frames that no slot shows from one turn before ``slot`` on, except the job's and missed ones."""
        with self._lock:
            offered = () if self._offered is None else (self._offered.number,)
            before = max(slot - self.count, 0)  # a late packer may still request them
            after = (number for begin, number in self._table if begin >= before)
            wanted = {0, self.at(before), *after, *missed, *offered}
            self._versions = {number: each for number, each in self._versions.items() if number in wanted}
            for source in self.sources:
                source.forget(wanted)

    def split_number(self, number: int) -> tuple[int, int]:
        """Version and frame of a number in a queue."""
        return (0, number) if number == NONE else divmod(number, self.frames)

    def order(self, frames: np.ndarray) -> np.ndarray:
        """Numbers of the frames of all slots, as decided so far; black after the stop."""
        order, planned = frames.copy(), self.slots
        for begin, number in self._table:
            rest = frames[begin:planned]
            order[begin:planned] = np.where(rest == NONE, NONE, rest + number * self.frames)
        order[self.end : planned] = NONE
        return order


class VersionedFrames:
    """The frames of one projector by their numbers in a queue; a `FrameSource`."""

    def __init__(self, versions: FrameVersions, engine: int) -> None:
        self._versions, self._engine = versions, engine
        self.bits: int = versions.source(0, engine).bits
        self._packer: VersionedPacker | None = None

    def planes(self, numbers: np.ndarray) -> np.ndarray:
        versions, frames = np.divmod(np.asarray(numbers), self._versions.frames)
        found = {
            number: iter(self._versions.source(number, self._engine).planes(frames[versions == number]))
            for number in dict.fromkeys(versions.tolist())
        }
        return np.stack([next(found[number]) for number in versions.tolist()])

    def frame(self, number: int) -> np.ndarray:
        version, frame = divmod(int(number), self._versions.frames)
        return self._versions.source(version, self._engine).frame(frame)

    def packer(self, batch: int) -> VersionedPacker | None:
        """The packer of the frames on a device; None if there is none."""
        packs = getattr(self._versions.source(0, self._engine), "packer", None)
        made = None if packs is None else packs(batch)
        self._packer = None if made is None else VersionedPacker(self._versions, self._engine, made)
        return self._packer

    def prepare(self, version: FrameVersion) -> None:
        """Prepare the packer of a version in the calling thread. Raises `BadInput`."""
        if self._packer is not None:
            self._packer.prepare(version.number, version.sources[self._engine])

    def forget(self, wanted: Collection[int]) -> None:
        """Keep only the packers of these versions."""
        if self._packer is not None:
            self._packer.forget(wanted)


class VersionedPacker(PlanePacker):
    """Packs the frames of all versions, each with its own packer; one call is for one version."""

    device: Device

    def __init__(self, versions: FrameVersions, engine: int, made: DevicePacker) -> None:
        super().__init__(None, made.shape, np.iinfo(np.int64).max)
        self._versions, self._engine, self._made = versions, engine, {0: made}
        self.device, self._batch = made.device, made.batch

    def prepare(self, number: int, source: FrameSource) -> None:
        """Make what packs a version. Raises `BadInput` for frames of another shape."""
        packs = getattr(source, "packer", None)
        made = None if packs is None else packs(self._batch)
        if made is None or made.shape != self.shape:
            raise BadInput(
                f"the frames of version {number} are not of shape {self.shape} on the job's device: put them there"
            )
        self._made[number] = made

    def forget(self, wanted: Collection[int]) -> None:
        """Keep only the packers of these versions."""
        self._made = {number: made for number, made in self._made.items() if number in wanted}

    def read(self, frames: np.ndarray, out: np.ndarray) -> None:
        lit = frames != NONE
        number = int(frames[lit][0]) // self._versions.frames if lit.any() else 0
        if number not in self._made:  # a run segment began since
            self.prepare(number, self._versions.source(number, self._engine))
        self._made[number].read(np.where(lit, frames - number * self._versions.frames, NONE), out)

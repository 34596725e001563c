"""Dose in the resin: recorded from the true state of mirrors, lamp, lens and motion, and compared with the frames."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from vamgpu.hosts.emulators.array import DisplayedFrame
from vamgpu.hosts.frames.sources import MirrorArray
from vamgpu.hosts.schedules.schedule import Schedule
from vamgpu.hosts.schedules.timing import SECOND

MARGIN = 0.005  # share of a pose by which light may be early, relative to the position of the first light
NEAR = 0.02  # largest difference from a plane's power [1/m] at which the lens is on it


class DoseRecorder:
    """Light in the resin, by engine, plane and angle: seconds of full drive on each mirror."""

    # position: of the motion [angles] at a time [ns]; power: of the lens [1/m]; first: beginning of angle 0, None for
    # the place of the first light; drive: share of full of an engine's lamp; turn: number of angles per turn.

    def __init__(
        self, position: Callable[[int], float], mirrors: tuple[int, int], engines: int = 1,
        power: Callable[[int], float] | None = None, planes: Sequence[float] = (0.0,), first: float | None = None,
        drive: Callable[[int], float] | None = None,
    ) -> None:  # fmt: skip
        self._drive = drive or (lambda engine: 1.0)
        self._position, self._power, self._planes = position, power, np.asarray(planes, float)
        self.mirrors = mirrors
        self.engines = engines
        self.light: dict[tuple[int, int, int], np.ndarray] = {}
        self.astray: float = 0.0
        self.listeners: list[Callable[[np.ndarray, int, int], None]] = []
        self.first = first
        self.turn: int | None = None
        self._begins: np.ndarray | None = None
        self._awaited: tuple[float, float] | None = None
        self._times, self._channels, self._drives = [0], [0], [(1.0,) * engines]

    def scan(self, schedule: Schedule, dark: int = 0) -> None:
        """Set the angles of a vial. Each extends to the next, also for measured angles. dark: black frames at first."""
        self.turn, way = schedule.frames, (schedule.position - schedule.position[0]) / float(schedule.advance)
        turn = 360.0 / float(schedule.advance)
        if schedule.advance * schedule.frames != 360:
            whole = turn if schedule.repeats else turn * schedule.turns
            self._begins = np.append(way[: schedule.frames], whole)
        if not schedule.repeats and self.first is not None:  # turn 0 follows from the first light
            self._awaited = turn, (way[dark] + MARGIN) // turn

    def lamp(self, channels: int, now: int) -> None:
        if channels and self.first is None:
            self.first = self._position(now)
        self._times.append(now)
        self._channels.append(channels)
        self._drives.append(tuple(map(self._drive, range(self.engines))))
        if len(self._times) > 4000:
            del self._times[:2000], self._channels[:2000], self._drives[:2000]

    def shown(self, engine: int, shown: DisplayedFrame) -> None:
        for plane, (start, end) in enumerate(zip(shown.starts, shown.ends, strict=True)):
            self.lit(engine, shown.mirrors(plane, self.mirrors[1]), start, end)

    def lit(self, engine: int, mirrors: np.ndarray, start: int, end: int) -> None:
        """Record that mirrors [row, column] were on, or on for a share of the time, between two times [ns]."""
        if self._awaited is not None and mirrors.any():
            (turn, before), self._awaited = self._awaited, None
            self.first = turn * ((self._position(start) + MARGIN) // turn - before)
        for begin, stop, drive in self._lit(engine, start, end):
            light = mirrors if drive == 1.0 else drive * mirrors
            self._add(engine, light, begin, stop)
            for listen in self.listeners:
                listen(light, begin, stop)

    def _lit(self, engine: int, start: int, end: int) -> list[tuple[int, int, float]]:
        """When the engine's lamp was on between two times, and its drive."""
        times = self._times
        found, place = [], max(bisect_right(times, start) - 1, 0)
        while place < len(times) and times[place] < end:
            stop = times[place + 1] if place + 1 < len(times) else end
            low, high = max(start, times[place]), min(end, stop)
            if self._channels[place] >> engine & 1 and high > low:
                found.append((low, high, self._drives[place][engine]))
            place += 1
        return found

    def pose(self, now: int) -> float:
        """The angle that light reaches at a time [ns], counted over turns."""
        pose = self._position(now) - (self.first or 0.0) + MARGIN
        if self._begins is None:
            return pose
        turns, rest = divmod(pose, self._begins[-1])
        around = len(self._begins) - 1
        return turns * around + float(np.interp(rest, self._begins, np.arange(around + 1)))

    def _add(self, engine: int, mirrors: np.ndarray, start: int, end: int) -> None:
        low, high = self.pose(start), self.pose(end)
        edges = range(int(np.floor(min(low, high))) + 1, int(np.ceil(max(low, high))))
        cuts = sorted([start, *(round(start + (edge - low) / (high - low) * (end - start)) for edge in edges), end])
        for begin, stop in zip(cuts[:-1], cuts[1:], strict=True):
            if stop > begin:
                self._add_within(engine, mirrors, begin, stop)

    def _add_within(self, engine: int, mirrors: np.ndarray, start: int, end: int) -> None:
        seconds = (end - start) * 1e-9
        plane = self._plane(start, end)
        if plane is None:
            self.astray += seconds * float(mirrors.sum())
            return
        pose = int(np.floor(self.pose((start + end) // 2)))
        key = (engine, plane, pose if self.turn is None else pose % self.turn)
        if key not in self.light:
            self.light[key] = np.zeros(self.mirrors, np.float32)
        self.light[key] += seconds * mirrors[: self.mirrors[0]]

    def _plane(self, start: int, end: int) -> int | None:
        if self._power is None:
            return 0
        nearest = {self._nearest(self._power(time)) for time in (start, (start + end) // 2, end)}
        return nearest.pop() if len(nearest) == 1 else None

    def _nearest(self, power: float) -> int | None:
        plane = int(np.argmin(np.abs(self._planes - power)))
        return plane if abs(float(self._planes[plane]) - power) <= NEAR else None

    def seconds(self, engine: int, poses: int, turn: int | None = None) -> np.ndarray:
        """Seconds of light [plane, angle, row, column]; with ``turn``, angles are counted modulo a turn."""
        total = np.zeros((len(self._planes), poses, *self.mirrors))
        for (which, plane, pose), light in self.light.items():
            place = pose if turn is None else pose % turn
            if which == engine and 0 <= place < poses:
                total[plane, place] += light
        return total


def full_light(schedule: Schedule, engine: int) -> float:
    """Lit time of a full-on pixel in a slot, in seconds of full drive; machines round it to whole microseconds."""
    return int(schedule.on[0]) // 1000 * 1e-6 * float(schedule.power[0, engine])


BEHIND = 2  # number of angles after which a frame gets no more light
FULL = 255


class Leveled(Protocol):
    """Frames with levels."""

    def levels(self, numbers: np.ndarray) -> np.ndarray: ...  # uint8 [frame, row, column], 255 full on


@dataclass(frozen=True)
class DoseComparison:
    """Dose in the resin compared with that of the frames."""

    greatest: float  # greatest difference of a pixel, relative to full on
    frames: int  # number of compared frames
    beside: float  # light outside all frames, or while the lens moved [s of full-on pixels]

    def __str__(self) -> str:
        return (
            f"{self.frames} frames differ in the resin from the job by at most {self.greatest:.2g} of full on; "
            f"{self.beside:.2g} s of a pixel's light outside them"
        )


class DoseMonitor:
    """Watches a recorder; on its clock, it compares once per second. sources: per engine.  planes: focus planes."""

    def __init__(
        self, recorder: DoseRecorder, schedule: Schedule, sources: Sequence[Leveled], mirrors: MirrorArray,
        planes: int = 1,
    ) -> None:  # fmt: skip
        self._recorder, self._schedule, self._sources, self._mirrors = recorder, schedule, tuple(sources), mirrors
        self._planes, self._turn = planes, schedule.unit == "deg"
        self._poses = schedule.frames // planes
        self._light, self._next, self._at = recorder.light, 0, SECOND
        self._greatest, self._count, self._beside = 0.0, 0, 0.0
        turns = len(schedule) // schedule.frames if self._turn else 1
        self._times, self._cut = np.full(self._poses, turns), set[int]()

    def due(self) -> int | None:
        """Time of its next comparison [ns]."""
        return None if self._turn else self._at

    def advance(self, now: int) -> None:
        """Compare finished angles, and drop them."""
        self._at = now + SECOND
        if self._light:
            newest = max(pose for _, _, pose in self._light)
            self._compare(min(newest - BEHIND, self._poses))

    def verdict(self, shown: Sequence[int] | None = None) -> DoseComparison:
        """Compare the rest after the print. shown: frames of a stopped vial, in order."""
        if shown is not None:
            self._times = np.bincount(np.asarray(shown, int), minlength=self._poses)
            last = int(shown[-1]) if len(shown) else 0
            self._cut = {last, (last + 1) % self._poses}
        if self._turn:
            self._light = {}
            for (engine, plane, pose), seconds in self._recorder.light.items():
                place = (engine, plane, pose % self._poses)
                before = self._light.get(place)
                self._light[place] = seconds if before is None else before + seconds
        self._compare(self._poses)
        self._beside += sum(float(light.sum()) for light in self._light.values())
        return DoseComparison(self._greatest, self._count, self._beside + self._recorder.astray)

    def _compare(self, stop: int) -> None:
        if stop <= self._next:
            return
        numbers = np.arange(self._next * self._planes, stop * self._planes)
        for engine, source in enumerate(self._sources):
            once = full_light(self._schedule, engine)
            levels = source.levels(numbers)
            down, across = self._mirrors.place(*levels.shape[1:])
            for number, expected in zip(numbers.tolist(), levels, strict=True):
                pose, plane = divmod(number, self._planes)
                seconds = self._light.pop((engine, plane, pose), None)
                if pose in self._cut:
                    continue
                full, right = max(int(self._times[pose]), 1) * once, expected / FULL * (self._times[pose] > 0)
                got = np.zeros(expected.shape) if seconds is None else seconds[down, across] / full
                self._greatest = max(self._greatest, float(np.abs(got - right).max()))
                if seconds is not None:
                    whole, own = (each.sum(dtype=np.float64) for each in (seconds, seconds[down, across]))
                    self._beside += max(0.0, float(whole - own))
            self._count += len(numbers) - len(self._cut & set((numbers // self._planes).tolist())) * self._planes
        self._next = stop

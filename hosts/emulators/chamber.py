"""What resin gets: it sees mirrors, lamp, lens and motion as they truly were, and nothing of what the host wanted.

A picture's light goes to the pose that the motion was in, and to the focus plane that the lens was at, while the lamp
shone; light from a lens under way goes astray.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Sequence

import numpy as np

from vamgpu.hosts.emulators.array import Shown
from vamgpu.hosts.schedules.schedule import Schedule

MARGIN = 0.005
"""Share of a pose by which light may come too early, from where the first light fell."""
NEAR = 0.02
"""Within how much of a plane's power [1/m] the lens is at it."""


class Chamber:
    """Light in the resin, by engine, plane and pose: seconds of full drive on each mirror.

    position: of the motion at a time [ns], in poses.  power: of the lens [1/m] at a time.  planes: their powers.
    mirrors: rows and columns of the arrays.  first: where pose 0 begins; None for where the first light falls.
    ``turn``: poses that come round again are one, where it is set; `scan` sets it.  ``hears`` are told of light as it
    falls: mirrors, start and end [ns].
    """

    def __init__(
        self,
        position: Callable[[int], float],
        mirrors: tuple[int, int],
        engines: int = 1,
        power: Callable[[int], float] | None = None,
        planes: Sequence[float] = (0.0,),
        first: float | None = None,
    ) -> None:
        self._position, self._power, self._planes = position, power, np.asarray(planes, float)
        self.mirrors, self.engines = mirrors, engines
        self.light: dict[tuple[int, int, int], np.ndarray] = {}
        self.astray = 0.0
        self.hears: list[Callable[[np.ndarray, int, int], None]] = []
        self.first = first
        self.turn: int | None = None
        self._begins: np.ndarray | None = None
        self._times, self._channels = [0], [0]

    def scan(self, schedule: Schedule) -> None:
        """Poses of a vial come round again. Each reaches to the next, wherever measured angles put it."""
        self.turn, turn = schedule.frames, schedule.position[: schedule.frames]
        if schedule.advance * schedule.frames != 360:
            self._begins = np.append(turn - turn[0], 360.0) / float(schedule.advance)

    def lamp(self, channels: int, now: int) -> None:
        """The lamp changes."""
        if channels and self.first is None:
            self.first = self._position(now)
        self._times.append(now)
        self._channels.append(channels)
        if len(self._times) > 4000:
            del self._times[:2000], self._channels[:2000]

    def shown(self, engine: int, shown: Shown) -> None:
        """Mirrors have shown a picture."""
        for plane, (start, end) in enumerate(zip(shown.starts, shown.ends, strict=True)):
            self.lit(engine, shown.mirrors(plane, self.mirrors[1]), start, end)

    def lit(self, engine: int, mirrors: np.ndarray, start: int, end: int) -> None:
        """Mirrors [row, column] were on, or on for a share of the time, from one time to another [ns]."""
        for begin, stop in self._lit(engine, start, end):
            self._add(engine, mirrors, begin, stop)
            for hear in self.hears:
                hear(mirrors, begin, stop)

    def _lit(self, engine: int, start: int, end: int) -> list[tuple[int, int]]:
        """When the engine's lamp shone between two times."""
        times = self._times
        found, place = [], max(bisect_right(times, start) - 1, 0)
        while place < len(times) and times[place] < end:
            stop = times[place + 1] if place + 1 < len(times) else end
            low, high = max(start, times[place]), min(end, stop)
            if self._channels[place] >> engine & 1 and high > low:
                found.append((low, high))
            place += 1
        return found

    def _pose(self, now: int) -> float:
        pose = self._position(now) - (self.first or 0.0) + MARGIN
        if self._begins is None:
            return pose
        turns, rest = divmod(pose, self._begins[-1])
        around = len(self._begins) - 1
        return turns * around + float(np.interp(rest, self._begins, np.arange(around + 1)))

    def _add(self, engine: int, mirrors: np.ndarray, start: int, end: int) -> None:
        low, high = self._pose(start), self._pose(end)
        cuts = [start, end]
        for edge in range(int(np.floor(min(low, high))) + 1, int(np.ceil(max(low, high)))):
            cuts.append(round(start + (edge - low) / (high - low) * (end - start)))
        cuts.sort()
        for begin, stop in zip(cuts[:-1], cuts[1:], strict=True):
            if stop > begin:
                self._add_within(engine, mirrors, begin, stop)

    def _add_within(self, engine: int, mirrors: np.ndarray, start: int, end: int) -> None:
        seconds = (end - start) * 1e-9
        plane = self._plane(start, end)
        if plane is None:
            self.astray += seconds * float(mirrors.sum())
            return
        pose = int(np.floor(self._pose((start + end) // 2)))
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
        """Seconds of light [plane, pose, row, column]; with ``turn`` poses are counted modulo a turn."""
        total = np.zeros((len(self._planes), poses, *self.mirrors))
        for (which, plane, pose), light in self.light.items():
            place = pose if turn is None else pose % turn
            if which == engine and 0 <= place < poses:
                total[plane, place] += light
        return total

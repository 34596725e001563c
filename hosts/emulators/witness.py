"""Compares what resin saw with the pictures of a job, pose by pose while it prints, in memory that does not grow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from vamgpu.hosts.emulators.chamber import Chamber
from vamgpu.hosts.pictures.stream import Mirrors
from vamgpu.hosts.schedules.schedule import Schedule
from vamgpu.hosts.schedules.timing import SECOND

BEHIND = 2
"""Poses after which no light falls into one any more."""
FULL = 255


class Leveled(Protocol):
    """Pictures that tell their levels."""

    def levels(self, numbers: np.ndarray) -> np.ndarray:
        """Of pictures, uint8 [picture, row, column], 255 full on."""
        ...


@dataclass(frozen=True)
class Verdict:
    """What resin saw, against the frames. greatest: difference in the light of any pixel, in shares of full on.

    pictures: compared.  beside: light outside of all pictures, or while the lens moved, in seconds of full-on pixels.
    """

    greatest: float
    pictures: int
    beside: float

    def __str__(self) -> str:
        return (
            f"{self.pictures} pictures differ from their frames by {self.greatest:.2g} of full on at most; "
            f"{self.beside:.2g} s of a pixel's light beside them"
        )


class Witness:
    """Watches a chamber; attached to its clock, it looks once a second. pictures: of each engine.  planes: of focus."""

    def __init__(
        self, chamber: Chamber, schedule: Schedule, pictures: Sequence[Leveled], mirrors: Mirrors, planes: int = 1
    ) -> None:
        self._chamber, self._schedule, self._pictures, self._mirrors = chamber, schedule, tuple(pictures), mirrors
        self._planes, self._turn = planes, schedule.unit == "deg"
        self._poses = schedule.frames // planes
        self._light, self._next, self._at = chamber.light, 0, SECOND
        self._greatest, self._count, self._beside = 0.0, 0, 0.0
        turns = len(schedule) // schedule.frames if self._turn else 1
        self._times, self._cut = np.full(self._poses, turns), set[int]()

    def due(self) -> int | None:
        """When it looks next [ns]."""
        return None if self._turn else self._at

    def advance(self, now: int) -> None:
        """Compare the poses that are over, and forget them."""
        self._at = now + SECOND
        if self._light:
            newest = max(pose for _, _, pose in self._light)
            self._compare(min(newest - BEHIND, self._poses))

    def verdict(self, shown: Sequence[int] | None = None) -> Verdict:
        """What was found, once the print is over.

        shown: pictures of a vial that was stopped, in order. Where the light went out is not compared: at the last of
        them, or the next.
        """
        if shown is not None:
            self._times = np.bincount(np.asarray(shown, int), minlength=self._poses)
            last = int(shown[-1]) if len(shown) else 0
            self._cut = {last, (last + 1) % self._poses}
        if self._turn:
            self._light = {}
            for (engine, plane, pose), seconds in self._chamber.light.items():
                place = (engine, plane, pose % self._poses)
                before = self._light.get(place)
                self._light[place] = seconds if before is None else before + seconds
        self._compare(self._poses)
        self._beside += sum(float(light.sum()) for light in self._light.values())
        return Verdict(self._greatest, self._count, self._beside + self._chamber.astray)

    def _compare(self, stop: int) -> None:
        if stop <= self._next:
            return
        numbers = np.arange(self._next * self._planes, stop * self._planes)
        once = (int(self._schedule.on[0]) // 1000) * 1e-6
        for engine, pictures in enumerate(self._pictures):
            levels = pictures.levels(numbers)
            down, across = self._mirrors.place(*levels.shape[1:])
            for number, wanted in zip(numbers.tolist(), levels, strict=True):
                pose, plane = divmod(number, self._planes)
                seconds = self._light.pop((engine, plane, pose), None)
                if pose in self._cut:
                    continue
                full, right = max(int(self._times[pose]), 1) * once, wanted / FULL * (self._times[pose] > 0)
                got = np.zeros(wanted.shape) if seconds is None else seconds[down, across] / full
                self._greatest = max(self._greatest, float(np.abs(got - right).max()))
                if seconds is not None:
                    whole, own = (each.sum(dtype=np.float64) for each in (seconds, seconds[down, across]))
                    self._beside += max(0.0, float(whole - own))
            self._count += len(numbers) - len(self._cut & set((numbers // self._planes).tolist())) * self._planes
        self._next = stop

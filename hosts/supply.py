"""Parts of a print: whether the motion keeps its speed, mirrors as a way to make it dark, and pictures on their way."""

from __future__ import annotations

from collections import deque

import numpy as np

from vamgpu.hosts.clock import Clock
from vamgpu.hosts.drivers.dmd import Dmd, PlaneStream
from vamgpu.hosts.schedule import Schedule
from vamgpu.hosts.stream import Pictures

WINDOW = 1_000_000_000
"""Over which the motion's speed is judged [ns]."""


class Motion:
    """Whether a motion keeps its speed: how far it is from where it should be after the last second, in poses."""

    def __init__(self, schedule: Schedule, microsteps: float) -> None:
        self._per_pose = float(schedule.advance) * microsteps
        self._period = float(schedule.cadence.period)
        self._seen: deque[tuple[int, int]] = deque()

    def error(self, now: int, position: int) -> float:
        """The error [poses] at a position [microsteps]."""
        self._seen.append((now, position))
        while now - self._seen[0][0] > WINDOW:
            self._seen.popleft()
        began, start = self._seen[0]
        return (position - start) / self._per_pose - (now - began) / self._period


class Dark:
    """Mirrors as a way to make it dark."""

    def __init__(self, dmd: Dmd) -> None:
        self._dmd = dmd

    def off(self) -> None:
        """Halt: the mirrors turn away."""
        self._dmd.halt()


class Supply:
    """Pictures of one projector on their way to its mirrors."""

    def __init__(self, stream: PlaneStream, pictures: Pictures, frames: np.ndarray, clock: Clock, first: int) -> None:
        self._stream, self._pictures, self._frames = stream, pictures, frames
        self._first, self._length, self._clock = first, stream.length, clock
        self._arrived: list[int] = []
        self.ahead, self.share = 0, 0.0

    def fill(self) -> None:
        """Upload and queue as much as there is room for."""
        while self._stream.room() and self._first + self._stream.queued < len(self._frames):
            start = self._first + self._stream.queued
            before = self._stream.queued
            self._stream.put(self._pictures.planes(self._frames[start : start + self._length]))
            self._arrived += [self._clock.now()] * (self._stream.queued - before)
        self.ahead = self._stream.queued - self.shown()
        self.share = min(1.0, self.ahead / (2 * self._length))

    def arrived(self, slot: int) -> int:
        """When a slot's picture was at the mirrors [ns]."""
        return self._arrived[slot - self._first]

    def shown(self) -> int:
        """Pictures since the leg began."""
        return self._stream.shown()

    def close(self) -> None:
        """Give the mirrors' memory back."""
        self._stream.close()

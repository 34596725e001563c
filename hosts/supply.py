"""Parts of a print: whether the motion keeps its speed, mirrors as a way to make it dark, and pictures on their way."""

from __future__ import annotations

import logging
import math
from collections import deque
from typing import cast

from vamgpu.errors import Underrun
from vamgpu.hosts.clock import Clock
from vamgpu.hosts.drivers.dmd import Dmd, PlaneStream
from vamgpu.hosts.feed import Feed, Sink
from vamgpu.hosts.schedule import Schedule
from vamgpu.hosts.stream import Pictures, source
from vamgpu.hosts.underrun import Action, WebUnderrun

log = logging.getLogger(__name__)
BUFFERS = 2
"""Of pictures made ahead, each as long as a sequence of the mirrors."""
GUARD = 0.06
"""How far ahead of the counter [s] a missing picture is given up: three looks of the print."""
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


class _Ahead(Feed):
    """A feed whose thread makes pictures; uploads stay with the thread that prints, which alone talks to mirrors."""

    def _uploading(self) -> None:
        pass


class Supply:
    """Pictures of one projector on their way to its mirrors, made ahead in a thread of their own.

    first: slot they begin with.  policy: decides on pictures that are late.  threaded: False on a clock that a program
    sets, where pictures are made when they are wanted, so that a print repeats exactly.
    """

    def __init__(
        self, stream: PlaneStream, pictures: Pictures, schedule: Schedule, clock: Clock, first: int, *,
        policy: WebUnderrun, threaded: bool,
    ) -> None:  # fmt: skip
        self._stream, self._schedule, self._first, self._policy = stream, schedule, first, policy
        order, shape = schedule.frame[first:], (pictures.bits, *stream.dmd.plane_shape)
        made = source(pictures, shape, int(schedule.frame.max()) + 1, stream.length)
        self._feed = _Ahead(made, order, cast(Sink, stream), clock, batch=stream.length, depth=BUFFERS)
        self._guard = max(2, math.ceil(GUARD * schedule.rate))
        self.ahead, self.share = 0, 0.0
        if threaded:
            self._feed.start()

    @property
    def primed(self) -> bool:
        """Whether mirrors and buffers hold all they can."""
        return self._feed.primed

    def prime(self) -> None:
        """Upload what is ready, before the light; raises what the making of pictures raised."""
        self._feed.check()
        if self._feed.threaded:
            self._feed.upload()
        else:
            self._feed.pump()
        self.ahead = self._feed.uploaded - self.shown()
        self.share = min(1.0, self.ahead / (2 * self._stream.length))

    def fill(self) -> None:
        """Upload what is ready and has room; where nothing is and time is short, ask the policy. Raises `Underrun`."""
        self.prime()
        while self.ahead < self._guard and not self._feed.done and self._stream.room():
            if self._feed.upload():
                self.ahead = self._feed.uploaded - self.shown()
                continue
            slot = self._first + self._feed.black()
            pose = int(self._schedule.pose[slot])
            log.warning("slot %d (pose %d) is black: its picture is not there", slot, pose)
            if self._policy.lost(pose) is Action.STOP:
                raise Underrun(
                    f"more than {self._policy.allowed} of {self._policy.window} poses were lost, the last at slot "
                    f"{slot} (pose {pose}): the light is off; print slower, or make pictures faster"
                )
            self.ahead = self._feed.uploaded - self.shown()

    def arrived(self, slot: int) -> int:
        """When a slot's picture was at the mirrors [ns]."""
        return int(self._feed.arrived[slot - self._first])

    def black(self, slot: int) -> bool:
        """Whether a slot's picture was late, and black instead."""
        return slot - self._first in self._feed.late

    def shown(self) -> int:
        """Pictures since the leg began."""
        return self._stream.shown()

    def stop(self) -> None:
        """Make no more pictures; mirrors are left as they are."""
        self._feed.stop()

    def close(self) -> None:
        """Give the mirrors' memory back, and make no more pictures."""
        self._stream.close()
        self.stop()

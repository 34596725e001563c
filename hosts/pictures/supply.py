"""Pictures on their way to mirrors, and mirrors as a way to make it dark."""

from __future__ import annotations

import logging
import math
from typing import cast

import numpy as np

from vamgpu.errors import Underrun
from vamgpu.hosts.clock import Clock
from vamgpu.hosts.drivers.dmd import Dmd
from vamgpu.hosts.drivers.stream import PlaneStream
from vamgpu.hosts.pictures.feed import Feed, Sink
from vamgpu.hosts.pictures.stream import Pictures, source
from vamgpu.hosts.pictures.underrun import Action, Underruns
from vamgpu.hosts.schedules.schedule import NONE

log = logging.getLogger(__name__)
BUFFERS = 2
"""Of pictures made ahead, each as long as a sequence of the mirrors."""
GUARD = 0.06
"""How far ahead of the counter [s] a missing picture is given up: three looks of the print."""
HELD = 2**28
"""Bytes of a sequence at rates so high that a second's pictures are more than a host should hold."""


def guard(rate: float) -> int:
    """How many pictures ahead of the counter a missing one is given up, at so many a second."""
    return max(2, math.ceil(GUARD * rate))


def length(rate: float, nbytes: int) -> int:
    """Pictures of ``nbytes`` in a sequence of mirrors, at so many a second: a second's, or what `HELD` bytes hold."""
    return max(guard(rate), min(round(rate), HELD // nbytes))


class Dark:
    """Mirrors as a way to make it dark."""

    def __init__(self, dmd: Dmd) -> None:
        self._dmd = dmd

    def off(self) -> None:
        """Halt: the mirrors turn away."""
        self._dmd.halt()


class Supply:
    """Pictures of one projector on their way to its mirrors, made and uploaded ahead in threads of their own.

    slots: frame of each slot of a leg.  poses: of each slot.  preroll: black pictures before the first slot.  policy:
    decides on pictures that are late.  threaded: False on a clock that a program sets, where pictures are made when
    they are wanted, so that a print repeats exactly.
    """

    def __init__(
        self, stream: PlaneStream, pictures: Pictures, slots: np.ndarray, poses: np.ndarray, clock: Clock, rate: float,
        *, policy: Underruns, preroll: int = 0, threaded: bool,
    ) -> None:  # fmt: skip
        self._stream, self._poses, self._policy, self._preroll = stream, poses, policy, preroll
        self._order = order = np.concatenate([np.full(preroll, NONE, slots.dtype), slots])
        shape = (pictures.bits, *stream.dmd.plane_shape)
        made = source(pictures, shape, int(slots.max(initial=0)) + 1, stream.length)
        self._feed = Feed(made, order, cast(Sink, stream), clock, batch=stream.length, depth=BUFFERS)
        self._guard = guard(rate)
        self.ahead, self.share = 0, 0.0
        if threaded:
            self._feed.start()

    @property
    def primed(self) -> bool:
        """Whether mirrors and buffers hold all they can."""
        return self._feed.primed

    def prime(self) -> None:
        """Raise what the making of pictures raised; without threads, make and upload what there is room for."""
        self._feed.check()
        if not self._feed.threaded:
            self._feed.pump()
        self._count()

    def fill(self) -> None:
        """Where nothing is ready and time is short, show black and ask the policy. Raises `Underrun`."""
        self.prime()
        while self.ahead < self._guard and not self._feed.done:
            slot = self._feed.black()
            if slot is None:
                return
            self.prime()
            if self._order[slot] == NONE:  # black was right
                continue
            pose = int(self._poses[slot - self._preroll])
            log.warning("pose %d is black: its picture is not there", pose)
            if self._policy.lost(pose) is Action.STOP:
                raise Underrun(
                    f"{self._policy.stopped}, the last at pose {pose}: the light is off; print slower, or make "
                    "pictures faster"
                )

    def _count(self) -> None:
        self.ahead = self._feed.uploaded - self.shown()
        self.share = min(1.0, self.ahead / (2 * self._stream.length))

    def arrived(self, slot: int) -> int:
        """When the picture of a leg's slot was at the mirrors [ns]."""
        return int(self._feed.arrived[slot + self._preroll])

    def black(self, slot: int) -> bool:
        """Whether the picture of a leg's slot was late, and black instead."""
        return slot + self._preroll in self._feed.late

    def shown(self) -> int:
        """Pictures since the leg began, black ones before the first slot included."""
        return self._stream.shown()

    def take_back(self, slot: int) -> None:
        """Tell the policy that black from a slot of the leg on never came: the leg ends before it."""
        for number in sorted(self._feed.late, reverse=True):
            if number >= slot + self._preroll and self._order[number] != NONE:
                self._policy.regained(int(self._poses[number - self._preroll]))

    def close(self) -> None:
        """Make no more pictures and give the mirrors' memory back, unless an upload hangs in it."""
        self._stream.cease()
        if self._feed.stop():
            self._stream.close()
        else:
            self._stream.dmd.halt()

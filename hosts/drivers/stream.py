"""More pictures than mirrors have memory for: sequences in turn, filled by one thread while another asks."""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass

import numpy as np

from vamgpu.errors import BadInput, DeviceError
from vamgpu.hosts.drivers import alp
from vamgpu.hosts.drivers.dmd import Dmd, Limits, Sequence, SlotTiming

PIECE = 2**21
"""Bytes of one call that uploads: some milliseconds of a wire."""


class Turns:
    """A lock that is handed on in the order of asking: who takes it again and again holds nobody up."""

    def __init__(self) -> None:
        self._lock, self._held = threading.Lock(), False
        self._waiting: deque[threading.Lock] = deque()

    def __enter__(self) -> None:
        ticket = threading.Lock()
        ticket.acquire()
        joined = False
        try:
            with self._lock:
                joined = True
                if not self._held:
                    self._held = True
                    return
                self._waiting.append(ticket)
            ticket.acquire()
        except BaseException:  # a signal that ends the program
            if joined:
                self._leave(ticket)
            raise

    def _leave(self, ticket: threading.Lock) -> None:
        """Wait no more; a turn that was given meanwhile goes to the next."""
        with self._lock:
            waits = ticket in self._waiting
            if waits:
                self._waiting.remove(ticket)
        if not waits:
            self.__exit__()

    def __exit__(self, *_: object) -> None:
        with self._lock:
            if self._waiting:
                self._waiting.popleft().release()
            else:
                self._held = False


@dataclass(frozen=True, eq=False)
class _Queued:
    """A sequence in the queue. shown: its pictures.  home: where it goes back to."""

    sequence: Sequence
    shown: int
    home: deque[Sequence]


class PlaneStream:
    """Sequences in turn: one is shown while others are filled.

    length: pictures of a sequence.  sequences: how many there are; enough for all pictures make them resident.  spares:
    sequences of one picture, for those that are to be shown alone.  ``shown`` counts pictures by the device's own
    progress, so it is right whatever the host's time does. Whether a picture counts when it begins or when it ends is
    the device's to say: compare with the count of triggers before there is light.

    One thread may put while another asks: uploads go in pieces of `PIECE` bytes, and nobody waits longer than for one.
    """

    def __init__(
        self, dmd: Dmd, length: int, bits: int, timing: SlotTiming = SlotTiming(), sequences: int = 2, spares: int = 0
    ) -> None:
        if sequences < 2:
            raise BadInput(f"{sequences} sequences; wanted 2 or more, one to show and one to fill")
        self.dmd, self.length, self.bits = dmd, length, bits
        self._free = deque(dmd.sequence(length, bits, timing) for _ in range(sequences))
        self._spare = deque(dmd.sequence(1, bits, timing) for _ in range(spares))
        self._queue: deque[_Queued] = deque()
        self.queued = 0
        self._turns = Turns()
        self._piece = max(1, PIECE // (bits * dmd.height * dmd.row_bytes))
        self._ceased = False

    def limits(self) -> Limits:
        """What the device allows for these pictures."""
        with self._turns:
            return [*self._free, *(each.sequence for each in self._queue)][0].limits()

    def room(self, pictures: int = 2) -> bool:
        """Whether so many pictures can be put now."""
        with self._turns:
            self._progress()
            return bool(self._home(pictures))

    def _home(self, pictures: int) -> deque[Sequence]:
        return self._spare if pictures == 1 and self._spare else self._free

    def put(self, planes: np.ndarray) -> None:
        """Upload up to ``length`` pictures ``[picture, plane, row, byte]`` and queue them; none once it ceased."""
        with self._turns:
            self._progress()
            home = self._home(len(planes))
            if not home:
                raise DeviceError("all sequences are in the queue; wait for room() before the next pictures")
            sequence = home.popleft()
        for first in range(0, len(planes), self._piece):
            with self._turns:
                if not self._ceased:
                    sequence.put(planes[first : first + self._piece], first)
        with self._turns:
            if self._ceased:
                home.append(sequence)
                return
            sequence.start(len(planes))
            self._queue.append(_Queued(sequence, len(planes), home))
            self.queued += len(planes)

    def shown(self) -> int:
        """How many pictures have begun to show since the start."""
        with self._turns:
            return self._progress()

    def _progress(self) -> int:
        progress = self.dmd.progress()
        idle = bool(progress.flags & alp.FLAG_QUEUE_IDLE)
        while len(self._queue) > (0 if idle else 1 + progress.waiting):
            done = self._queue.popleft()
            done.home.append(done.sequence)
        waiting = sum(each.shown for each in list(self._queue)[1:])
        return self.queued - waiting - (0 if idle else progress.frames_left)

    def cease(self) -> None:
        """Upload no further piece, so that who uploads may end soon; waits for nobody."""
        self._ceased = True

    def close(self) -> None:
        """Halt and give the memory back."""
        self.dmd.halt()
        for sequence in (*self._free, *self._spare, *(each.sequence for each in self._queue)):
            sequence.free()
        self._free.clear()
        self._spare.clear()
        self._queue.clear()

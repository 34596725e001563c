"""The mirrors' memory: sequences in rotation, which one thread fills and another reads without waiting."""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass

import numpy as np

from vamgpu.errors import BadInput, DeviceError
from vamgpu.hosts.drivers import alp
from vamgpu.hosts.drivers.dmd import Dmd, PlaneSequence, SlotTiming

PIECE = 2**21  # bytes per upload call: some milliseconds on the wire


class FairLock:
    """A fair lock, granted in the order of requests; a thread that takes it repeatedly does not block others."""

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
        """Stop waiting; a turn granted in the meantime goes to the next."""
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


@dataclass(eq=False)
class _Stored:
    """A sequence of the device."""

    sequence: PlaneSequence
    home: deque[_Stored]  # where it waits, the least recently shown first
    name: bytes | None = None  # names of its frames, which may be shown again
    promised: int = 0  # how often they will be shown


class MirrorMemory:
    """Sequences in rotation, one shown while others are filled; spares hold one frame each."""

    # One thread may put while another reads: uploads go in pieces of `PIECE` bytes. `shown` follows the device's own
    # progress; the device counts a frame at its beginning or at its end: compare with triggers in the dark.

    def __init__(
        self, dmd: Dmd, length: int, bits: int, timing: SlotTiming = SlotTiming(), sequences: int = 2, spares: int = 0
    ) -> None:
        if sequences < 2:
            raise BadInput(f"{sequences} sequences; expected 2 or more, one to show and one to fill")
        self.dmd = dmd
        self.length = length
        self.bits = bits
        self._free: deque[_Stored] = deque()
        self._spare: deque[_Stored] = deque()
        for home, count, frames in ((self._free, sequences, length), (self._spare, spares, 1)):
            home.extend(_Stored(dmd.sequence(frames, bits, timing), home) for _ in range(count))
        self._all: tuple[_Stored, ...] = (*self._free, *self._spare)
        self._queue: deque[tuple[_Stored, int]] = deque()  # and number of its shown frames
        self.queued: int = 0
        self._turns = FairLock()
        self._piece = max(1, PIECE // (bits * dmd.height * dmd.row_bytes))
        self._cancelled = False

    def room(self, frames: int = 2, name: bytes | None = None) -> bool:
        """Whether ``frames`` can be put now, or those of a stored name be shown again."""
        with self._turns:
            self._progress()
            found = self._idle(frames) if name is None else self._named(name, idle=True)
            return found is not None and self.dmd.queue_places() > 0

    def _idle(self, frames: int) -> _Stored | None:
        """A sequence with room for the frames; its own will not be shown again."""
        home = self._spare if frames == 1 and self._spare else self._free
        return next((stored for stored in home if not stored.promised), None)

    def _named(self, name: bytes, idle: bool = False) -> _Stored | None:
        """The sequence that starts with the frames of a name."""
        among = self._free if idle else self._all
        return next((stored for stored in among if stored.name is not None and stored.name.startswith(name)), None)

    def keep(self, name: bytes) -> bool:
        """Reserve the frames of a name to show them again; False if they are no longer at the mirrors."""
        with self._turns:
            stored = self._named(name)
            if stored is not None:
                stored.promised += 1
            return stored is not None

    def again(self, name: bytes, frames: int) -> None:
        """Queue the stored frames of a name without an upload. Needs `room` for the name."""
        with self._turns:
            stored = self._named(name, idle=True)
            if stored is None or not stored.promised:
                raise DeviceError("frames that are not stored, or are being shown; wait for room() before them")
            stored.promised -= 1
            stored.home.remove(stored)
            self._show(stored, frames)

    def put(self, planes: np.ndarray, name: bytes | None = None) -> None:
        """Upload frames ``[frame, plane, row, byte]`` and queue them, under a name to show them again."""
        with self._turns:
            self._progress()
            stored = self._idle(len(planes))
            if stored is None or not self.dmd.queue_places():
                raise DeviceError("all sequences are in the queue; wait for room() before the next frames")
            stored.home.remove(stored)
            stored.name = None
        for first in range(0, len(planes), self._piece):
            with self._turns:
                if not self._cancelled:
                    stored.sequence.put(planes[first : first + self._piece], first)
        with self._turns:
            if self._cancelled:
                stored.home.append(stored)
                return
            stored.name = name
            self._show(stored, len(planes))

    def _show(self, stored: _Stored, frames: int) -> None:
        stored.sequence.start(frames)
        self._queue.append((stored, frames))
        self.queued += frames

    def shown(self) -> int:
        """Frames shown since the start."""
        with self._turns:
            return self._progress()

    def _progress(self) -> int:
        progress = self.dmd.progress()
        idle = bool(progress.flags & alp.FLAG_QUEUE_IDLE)
        while len(self._queue) > (0 if idle else 1 + progress.waiting):
            done, _ = self._queue.popleft()
            done.home.append(done)
        waiting = sum(frames for _, frames in list(self._queue)[1:])
        return self.queued - waiting - (0 if idle else progress.frames_left)

    def cancel(self) -> None:
        """Upload no further piece, which ends the uploading thread soon; does not wait."""
        self._cancelled = True

    def close(self, hung: bool = False) -> None:
        """Halt, and free the memory, unless an upload hangs in it."""
        self.dmd.halt()
        if hung:
            return
        for stored in self._all:
            stored.sequence.free()
        self._all = ()
        self._free.clear()
        self._spare.clear()
        self._queue.clear()

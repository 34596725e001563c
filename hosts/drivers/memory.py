"""The mirrors' memory: sequences in turn, filled by one thread while another asks, so that frames never run out."""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass

import numpy as np

from vamgpu.errors import BadInput, DeviceError
from vamgpu.hosts.drivers import alp
from vamgpu.hosts.drivers.dmd import Dmd, PlaneSequence, SlotTiming

PIECE = 2**21  # bytes of one call that uploads: some milliseconds of a wire


class FairLock:
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


@dataclass(eq=False)
class _Stored:
    """A sequence of the device."""

    sequence: PlaneSequence
    home: deque[_Stored]  # where it waits, those shown longest ago first
    name: bytes | None = None  # of its frames, which may be shown again
    promised: int = 0  # how often they will be


class MirrorMemory:
    """Sequences in turn, one shown while others are filled; spares hold one frame each."""

    # One thread may put while another asks: uploads go in pieces of `PIECE` bytes. `shown` follows the device's own
    # progress; whether it counts a frame at its begin or end is the device's: compare with the triggers in the dark.

    dmd: Dmd
    length: int
    bits: int

    def __init__(
        self, dmd: Dmd, length: int, bits: int, timing: SlotTiming = SlotTiming(), sequences: int = 2, spares: int = 0
    ) -> None:
        if sequences < 2:
            raise BadInput(f"{sequences} sequences; expected 2 or more, one to show and one to fill")
        self.dmd, self.length, self.bits = dmd, length, bits
        self._free: deque[_Stored] = deque()
        self._spare: deque[_Stored] = deque()
        for home, count, frames in ((self._free, sequences, length), (self._spare, spares, 1)):
            home.extend(_Stored(dmd.sequence(frames, bits, timing), home) for _ in range(count))
        self._all: tuple[_Stored, ...] = (*self._free, *self._spare)
        self._queue: deque[tuple[_Stored, int]] = deque()  # and how many of its frames are shown
        self.queued: int = 0
        self._turns = FairLock()
        self._piece = max(1, PIECE // (bits * dmd.height * dmd.row_bytes))
        self._cancelled = False

    def room(self, frames: int = 2, name: bytes | None = None) -> bool:
        """Whether so many frames can be put now, or those of a name that was kept be shown again."""
        with self._turns:
            self._progress()
            found = self._idle(frames) if name is None else self._named(name, idle=True)
            return found is not None and self.dmd.queue_places() > 0

    def _idle(self, frames: int) -> _Stored | None:
        """A sequence for so many frames, none of which is to be shown again."""
        home = self._spare if frames == 1 and self._spare else self._free
        return next((stored for stored in home if not stored.promised), None)

    def _named(self, name: bytes, idle: bool = False) -> _Stored | None:
        """The sequence that begins with the frames of a name."""
        among = self._free if idle else self._all
        return next((stored for stored in among if stored.name is not None and stored.name.startswith(name)), None)

    def keep(self, name: bytes) -> bool:
        """Promise to show the frames of a name again; False where they are not at the mirrors any more."""
        with self._turns:
            stored = self._named(name)
            if stored is not None:
                stored.promised += 1
            return stored is not None

    def again(self, name: bytes, frames: int) -> None:
        """Queue the frames of a name that was kept; they are not uploaded. Needs `room` for the name."""
        with self._turns:
            stored = self._named(name, idle=True)
            if stored is None or not stored.promised:
                raise DeviceError("these frames were not kept, or are being shown; wait for room() before showing them")
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
        """Frames that have begun to show since the start."""
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
        """Upload no further piece, so that who uploads may end soon; waits for nobody."""
        self._cancelled = True

    def close(self, hung: bool = False) -> None:
        """Halt, and give the memory back; not where an upload hangs in it."""
        self.dmd.halt()
        if hung:
            return
        for stored in self._all:
            stored.sequence.free()
        self._all = ()
        self._free.clear()
        self._spare.clear()
        self._queue.clear()

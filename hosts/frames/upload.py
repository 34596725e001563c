"""A queue that packs frames and uploads them to the mirrors' memory, in order, ahead of their time."""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Protocol

import numpy as np

from vamgpu.errors import BadInput, ShapeMismatch, Underrun, VamError
from vamgpu.hosts.frames.buffers import Batch, BufferRing, pinned_buffers
from vamgpu.hosts.frames.lateness import LatePolicy, WebLatePolicy
from vamgpu.hosts.frames.packer import PlanePacker
from vamgpu.hosts.frames.versions import Boundaries
from vamgpu.hosts.schedules.clock import Clock
from vamgpu.hosts.schedules.schedule import NONE

log: logging.Logger = logging.getLogger(__name__)
NAP = 2_000_000  # sleep of a thread when mirrors have no room [ns]
BUFFERS = 2  # number of buffers of prepared frames, each as long as a sequence of the mirrors
GUARD = 0.06  # time before its slot at which a missing frame is given up [s]: three polls of the print
HELD = 2**28  # most bytes of a sequence, for rates at which a second of frames is too much for a host


def guard(rate: float) -> int:
    """Number of slots before its own at which a missing frame is given up, for a rate per second."""
    return max(2, math.ceil(GUARD * rate))


def length(rate: float, nbytes: int) -> int:
    """Frames of ``nbytes`` in a sequence of mirrors, for a rate per second: those of a second, or of `HELD` bytes."""
    return max(guard(rate), min(round(rate), HELD // nbytes))


class FrameMemory(Protocol):
    """Mirrors that take frames ahead of their time and show one per trigger."""

    # whether ``put`` of the frames, or ``again`` of a name, would return at once
    def room(self, frames: int = 2, name: bytes | None = None) -> bool: ...
    # append frames [frame, …]; returns once their buffer may be used again
    def put(self, planes: np.ndarray, name: bytes | None = None) -> None: ...
    def shown(self) -> int: ...  # number of frames triggered so far

    def keep(self, name: bytes) -> bool: ...  # reserve the frames of a name to show them again; False if missing
    def again(self, name: bytes, frames: int) -> None: ...  # append the stored frames of a name
    def cancel(self) -> None: ...  # let a running upload end soon; does not wait
    def close(self, hung: bool = False) -> None: ...  # free the memory, except that of an upload that hangs


class UploadQueue:
    """Uploads frames of a projector in two threads, through a ring of buffers; without threads `pump` does both."""

    def __init__(
        self, packer: PlanePacker, order: np.ndarray, memory: FrameMemory, clock: Clock, *, batch: int = 8,
        depth: int = 8, poses: np.ndarray | None = None, policy: LatePolicy | None = None, guard: int = 2,
        preroll: int = 0, turn: int | None = None, boundaries: Boundaries | None = None,
    ) -> None:  # fmt: skip
        if order.ndim != 1 or order.dtype.kind != "i":
            raise ShapeMismatch(f"order is {order.dtype}{list(order.shape)}; expected whole numbers, one per slot")
        if order.size and not NONE <= order.min() <= order.max() < packer.frames:
            raise BadInput(f"order has frames {order.min()} to {order.max()}; the source has {packer.frames}")
        self._order = np.concatenate([np.full(preroll, NONE, order.dtype), order])
        self._packer, self._memory, self._clock = packer, memory, clock
        self._poses = np.arange(len(order)) if poses is None else poses
        self._policy, self._guard, self._preroll = policy or WebLatePolicy(), guard, preroll
        self._turn, self._boundaries = turn, boundaries
        self._taken, self._packing = 0, threading.Lock()
        self._limit = len(self._order)
        self._look_ahead(0)
        self.ring: BufferRing = BufferRing(pinned_buffers(depth, (batch, *packer.shape), packer.device))
        self.batch = batch
        self.uploaded: int = 0
        self.made: int = 0
        self.ahead: int = 0
        self.share: float = 0.0
        self.arrived: np.ndarray = np.full(len(self._order), NONE, np.int64)
        self.late: set[int] = set()  # slots that were black
        self._black = pinned_buffers(1, (1, *packer.shape), packer.device)[0]
        self._sending, self._stop = threading.RLock(), threading.Event()
        self._threads: tuple[threading.Thread, ...] = ()
        self._error: BaseException | None = None

    def __len__(self) -> int:
        return len(self._order)

    @property
    def done(self) -> bool:
        """Whether everything is at the mirrors."""
        return self.uploaded >= len(self)

    @property
    def primed(self) -> bool:
        """Whether mirrors and ring are full, so that the light may open."""
        if not self._sending.acquire(blocking=False):  # frames being uploaded are still in the ring
            return False
        try:
            full = self.ring.fill == self.ring.capacity or self.made >= self._limit
            head = self.ring.head()
            return self.uploaded >= self._limit or (full and head is not None and not self._room(head))
        finally:
            self._sending.release()

    def make(self, timeout: float = 0.0) -> bool:
        """Pack the next frames if a buffer is free within ``timeout`` seconds."""
        if self.made >= self._limit or (buffer := self.ring.claim(timeout)) is None:
            return False
        first = self.made
        with self._packing:
            frames = self._order[first : self._end(first)].copy()
            self._taken = first + len(frames)
        if not self._kept(first, buffer[: len(frames)]):
            self._packer.read(frames, buffer)
            self.ring.commit(Batch(first, buffer[: len(frames)]))
        self.made = first + len(frames)
        return True

    def _end(self, first: int) -> int:
        """End of a batch of frames from a slot; in turns, always at the same places."""
        turn = self._turn if self._boundaries is None else self._boundaries.turn
        if turn is None:
            return first + self.batch
        if first < self._preroll:
            return min(self._preroll, first + self.batch)
        beyond = self._place(first, turn)
        return first - beyond + min(turn, (beyond // self.batch + 1) * self.batch)

    def _place(self, slot: int, turn: int) -> int:
        """Place of a slot in its turn: of the print if frames may be replaced, else of the queue."""
        return (slot - self._preroll + (0 if self._boundaries is None else self._boundaries.first)) % turn

    def _look_ahead(self, shown: int) -> None:
        """Move the packing limit after a number of shown frames."""
        if (ends := self._boundaries) is not None:
            begin = ends.first - self._preroll
            self._limit = min(len(self), ends.horizon(begin + shown) - begin)

    def _name(self, first: int, count: int) -> bytes | None:
        """The name of frames at the mirrors, from their place in the turn and their numbers: none is queued twice."""
        if self._turn is None:
            return None
        turn = self._turn if self._boundaries is None else self._boundaries.turn
        place = np.int64(self._place(first, turn) if first >= self._preroll else NONE)
        return place.tobytes() + self._order[first : first + count].tobytes()

    def _kept(self, first: int, buffer: np.ndarray) -> bool:
        """Queue frames again that the mirrors still have; black cannot replace them meanwhile."""
        name = self._name(first, len(buffer))
        if name is None:
            return False
        with self._sending:
            if self.uploaded > first or not self._memory.keep(name):
                return False
            self.ring.commit(Batch(first, buffer, kept=True))
            return True

    def _room(self, batch: Batch) -> bool:
        return self._memory.room(name=self._name(batch.first, len(batch.frames))) if batch.kept else self._memory.room()

    def upload(self, timeout: float = 0.0) -> bool:
        """Upload the oldest frames if there are any within ``timeout`` seconds and the mirrors have room."""
        batch = self.ring.head(timeout)
        if batch is None:
            return False
        with self._sending:
            if not self._room(batch):
                return False
            behind = self.uploaded - batch.first
            if behind < len(batch.frames):
                self._put(batch.frames[behind:], batch.kept)
            self.ring.release()
        return True

    def black(self) -> int | None:
        """Show black in place of the next frame; returns its slot, or None if frames are ready or the ring is full."""
        if not self._sending.acquire(blocking=False):
            return None
        try:
            if self.ring.fill or not self._memory.room(1):
                return None
            slot = self.uploaded
            self._put(self._black)
            self.late.add(slot)
            return slot
        finally:
            self._sending.release()

    def _put(self, planes: np.ndarray, kept: bool = False) -> None:
        name = self._name(self.uploaded, len(planes))
        if name is None:
            self._memory.put(planes)
        elif kept:
            self._memory.again(name, len(planes))
        else:
            self._memory.put(planes, name)
        self.arrived[self.uploaded : self.uploaded + len(planes)] = self._clock.now()
        self.uploaded += len(planes)

    def pump(self) -> int:
        """Pack and upload until neither thread can continue; returns how many frames went to the mirrors."""
        before = self.uploaded
        while self.upload() or self.make():
            pass
        return self.uploaded - before

    def prime(self) -> None:
        """Raise the error of a thread; without threads, pack and upload while there is room."""
        self.check()
        if self._boundaries is not None:
            self._look_ahead(self._memory.shown())
        if not self._threads:
            self.pump()
        self.ahead = self.uploaded - self._memory.shown()
        self.share = min(1.0, self.ahead / (2 * self.batch))

    def feed(self) -> None:
        """If nothing is ready and time is short, show black and apply the policy. Raises `Underrun`."""
        self.prime()
        while self.ahead < self._guard and not self.done:
            slot = self.black()
            if slot is None:
                return
            self.prime()
            if self._order[slot] == NONE:  # black was right
                continue
            pose = int(self._poses[slot - self._preroll])
            log.warning("angle %d is black: its frame is missing", pose)
            if self._policy.drop(pose):
                raise Underrun(
                    f"{self._policy.stopped}, the last at angle {pose}: the light is off; print slower, or make "
                    "frames faster"
                )

    @contextmanager
    def replaceable(self, slot: int) -> Iterator[bool]:
        """Hold the queue; yield True if neither a frame nor black is packed yet from a slot on."""
        with self._packing:
            yield max(self._taken, self.uploaded) <= slot + self._preroll

    def replace(self, slot: int, order: np.ndarray) -> None:
        """Replace the frames from a slot that `replaceable` holds."""
        self._order[slot + self._preroll :] = order

    def arrival(self, slot: int) -> int:
        """Arrival of a slot's frame at the mirrors [ns]."""
        return int(self.arrived[slot + self._preroll])

    def was_black(self, slot: int) -> bool:
        """Whether the frame of a slot was late, and so black."""
        return slot + self._preroll in self.late

    def shown(self) -> int:
        """Frames since the run segment began, with the black ones before the first slot."""
        return self._memory.shown()

    def undo_drops(self, slot: int) -> None:
        """Uncount black frames from a slot on: the run segment ends before it."""
        for number in sorted(self.late, reverse=True):
            if number >= slot + self._preroll and self._order[number] != NONE:
                self._policy.undo_drop(int(self._poses[number - self._preroll]))

    def close(self) -> None:
        """Stop packing and free the mirrors' memory, unless an upload hangs in it."""
        self._memory.cancel()
        self._memory.close(hung=not self.stop())

    def start(self) -> None:
        """Start threads that pack and upload."""
        jobs = {"pack": self._making, "upload": self._uploading}
        self._threads = tuple(threading.Thread(target=self._guarded, args=(job,), name=f"frames {name}", daemon=True)
                              for name, job in jobs.items())  # fmt: skip
        for thread in self._threads:
            thread.start()

    def check(self) -> None:
        """Raise the error of a thread."""
        if self._error is not None:
            raise self._error

    def stop(self, timeout: float = 1.0) -> bool:
        """End the threads; False if one hangs in a driver and is left behind."""
        self._stop.set()
        self.ring.close()
        for thread in self._threads:
            thread.join(timeout)
        return not any(thread.is_alive() for thread in self._threads)

    def _guarded(self, job: Callable[[], None]) -> None:
        try:
            job()
        except BaseException as error:  # the printing thread raises it
            self._error = (
                error if isinstance(error, VamError) else VamError(f"packing or uploading frames failed: {error!r}")
            )
            if not isinstance(error, VamError):
                self._error.__cause__ = error

    def _making(self) -> None:
        while not self._stop.is_set() and self.made < len(self):
            if not self.make(0.1) and self.made >= self._limit:
                self._clock.sleep_until(self._clock.now() + NAP)

    def _uploading(self) -> None:
        while not self._stop.is_set() and not self.done:
            if not self.upload(0.1) and self.ring.fill:
                self._clock.sleep_until(self._clock.now() + NAP)

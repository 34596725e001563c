"""From device memory to the mirrors' memory: pictures in the order they are shown, made ahead, never too many."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from vamgpu.errors import BadInput, ShapeMismatch, VamError
from vamgpu.hosts.clock import Clock
from vamgpu.hosts.pictures.pinned import buffers
from vamgpu.hosts.pictures.ring import Batch, Ring
from vamgpu.hosts.pictures.sources import Source
from vamgpu.hosts.schedules.schedule import NONE

NAP = 2_000_000
"""How long a thread sleeps when mirrors have no room [ns]."""


class Sink(Protocol):
    """Mirrors that take pictures ahead of their time and show one a trigger."""

    def room(self, pictures: int = 2) -> bool:
        """Whether ``put`` of so many would not have to wait."""
        ...

    def put(self, pictures: np.ndarray) -> None:
        """Take pictures [picture, …] after those taken before; returns once the memory may be used again."""
        ...

    def shown(self) -> int:
        """How many pictures were triggered so far."""
        ...


@dataclass(frozen=True)
class Late:
    """A picture that came too late and was black. slot, frame: which.  missed: when it was given up [ns].  ready: when
    it was there after all [ns]; None while it is not."""

    slot: int
    frame: int
    missed: int
    ready: int | None = None


class Feed:
    """Brings the pictures of a print from a source to a sink, through a ring of buffers made beforehand.

    order: number of the frame in each slot.  batch: pictures a buffer.  depth: buffers.  Call ``pump`` as often as
    there is time, which on a clock that a program sets is exactly repeatable, or ``start`` two threads that do the
    same: one makes pictures, one uploads. Raises `BadInput`, `ShapeMismatch`.
    """

    def __init__(
        self, source: Source, order: np.ndarray, sink: Sink, clock: Clock, *, batch: int = 8, depth: int = 8
    ) -> None:
        if order.ndim != 1 or order.dtype.kind != "i":
            raise ShapeMismatch(f"order is {order.dtype}{list(order.shape)}; wanted whole numbers, one a slot")
        if order.size and not NONE <= order.min() <= order.max() < source.frames:
            raise BadInput(f"order asks for frames {order.min()} to {order.max()}; the source has {source.frames}")
        self._source, self._order, self._sink, self._clock = source, order, sink, clock
        device = getattr(source, "device", None)
        self.ring = Ring(buffers(depth, (batch, *source.shape), device))
        self.batch, self.uploaded, self.made = batch, 0, 0
        self.arrived = np.full(len(order), NONE, np.int64)
        self.late: dict[int, Late] = {}
        self._black = buffers(1, (1, *source.shape), device)[0]
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
        """Whether mirrors and ring hold all they can, so that the light may open."""
        full = self.ring.fill == self.ring.capacity or self.made >= len(self)
        return self.done or (full and not self._sink.room())

    # ---- one step of each side -----------------------------------------------------------------------------
    def make(self, timeout: float = 0.0) -> bool:
        """Make the next pictures if a buffer is free within ``timeout`` seconds."""
        if self.made >= len(self):
            return False
        buffer = self.ring.claim(timeout)
        if buffer is None:
            return False
        first = self.made
        frames = self._order[first : first + self.batch]
        self._source.read(frames, buffer)
        self.ring.commit(Batch(first, buffer[: len(frames)], self._clock.now()))
        self.made = first + len(frames)
        return True

    def upload(self, timeout: float = 0.0) -> bool:
        """Upload the oldest pictures if there are any within ``timeout`` seconds and the mirrors have room."""
        batch = self.ring.head(timeout)
        if batch is None:
            return False
        with self._sending:
            if not self._sink.room():
                return False
            behind = self.uploaded - batch.first
            for slot in range(batch.first, min(batch.end, self.uploaded)):  # those were black
                if slot in self.late and self.late[slot].ready is None:
                    self.late[slot] = Late(slot, self.late[slot].frame, self.late[slot].missed, batch.ready)
            if behind < len(batch.pictures):
                self._put(batch.pictures[behind:])
        self.ring.release()
        return True

    def black(self) -> int | None:
        """Show black in the next slot in place of a picture that is not there; returns the slot.

        None where pictures are ready, are being uploaded, or have no room: this waits for nobody.
        """
        if not self._sending.acquire(blocking=False):
            return None
        try:
            if self.ring.fill or not self._sink.room(1):
                return None
            slot = self.uploaded
            self._put(self._black)
            self.late[slot] = Late(slot, int(self._order[slot]), self._clock.now())
            return slot
        finally:
            self._sending.release()

    def _put(self, pictures: np.ndarray) -> None:
        self._sink.put(pictures)
        self.arrived[self.uploaded : self.uploaded + len(pictures)] = self._clock.now()
        self.uploaded += len(pictures)

    def pump(self) -> int:
        """Make and upload until neither can go on; returns how many pictures went to the mirrors."""
        before = self.uploaded
        while self.upload() or self.make():
            pass
        return self.uploaded - before

    # ---- threads -------------------------------------------------------------------------------------------
    def start(self) -> None:
        """Begin to make and upload in threads of their own."""
        jobs = {"make": self._making, "upload": self._uploading}
        self._threads = tuple(threading.Thread(target=self._kept, args=(job,), name=f"feed {name}", daemon=True)
                              for name, job in jobs.items())  # fmt: skip
        for thread in self._threads:
            thread.start()

    @property
    def threaded(self) -> bool:
        """Whether threads do the work."""
        return bool(self._threads)

    def check(self) -> None:
        """Raise what a thread failed with."""
        if self._error is not None:
            raise self._error

    def stop(self, timeout: float = 1.0) -> bool:
        """End the threads; False where one hangs in a driver and is left behind."""
        self._stop.set()
        self.ring.close()
        for thread in self._threads:
            thread.join(timeout)
        return not any(thread.is_alive() for thread in self._threads)

    def _kept(self, job: Callable[[], None]) -> None:
        try:
            job()
        except BaseException as error:  # it is raised where the print is run
            self._error = error if isinstance(error, VamError) else VamError(f"the feed failed: {error!r}")
            if not isinstance(error, VamError):
                self._error.__cause__ = error

    def _making(self) -> None:
        while not self._stop.is_set() and self.made < len(self):
            self.make(0.1)

    def _uploading(self) -> None:
        while not self._stop.is_set() and not self.done:
            if not self.upload(0.1) and self.ring.fill:
                self._clock.sleep_until(self._clock.now() + NAP)

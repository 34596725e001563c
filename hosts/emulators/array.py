"""A mirror array: frames in its memory, their queue, triggers, and the lit times of planes."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from vamgpu.hosts.emulators.clock import VirtualClock

MICRO = 1000


@dataclass(frozen=True)
class ArrayModel:
    """Size, memory and least frame times of a mirror array: one load of all rows, or the steps of gray."""

    height: int = 1080
    width: int = 1920
    planes: int = 31069  # bit planes that fit
    load_us: int = 44  # load time of all rows
    gray_us: int = 3760  # least time of 8 bits
    dark_us: int = 0  # dark part of every lit time
    bytes_per_s: float = 0.0  # speed of uploads; 0: instantaneous
    serial: int = 1001
    time_out_ns: int = 1_000_000_000

    @property
    def row_bytes(self) -> int:
        return 2048 // 8 if self.width == 1920 else self.width // 8

    def least_picture_us(self, bits: int) -> int:
        """The least time from frame to frame [us]."""
        return max(self.load_us, -(-self.gray_us * (2**bits - 1) // 255))


@dataclass(frozen=True)
class DisplayedFrame:
    """A displayed frame: planes ``[plane, row, byte]``, and the begin and end of each [ns]."""

    number: int  # since the device was opened
    sequence: int  # where it was stored, with ``frame``
    frame: int
    planes: np.ndarray
    starts: tuple[int, ...]
    ends: tuple[int, ...]

    def mirrors(self, plane: int, width: int) -> np.ndarray:
        """Which mirrors ``[row, column]`` a plane turned on, as 0 and 1."""
        return np.unpackbits(self.planes[plane], axis=-1)[:, :width]


@dataclass
class Stored:
    bits: int
    count: int
    last: int
    packed: bool = False
    uninterrupted: bool = False
    picture_us: int = 33334
    illuminate_us: int = 33333
    delay_us: int = 0
    frames: dict[int, np.ndarray] = field(default_factory=dict)


@dataclass
class Queued:
    queue_id: int
    sequence: int
    stored: Stored
    iterations: int | None
    frames: int
    next: int = 0


class EmulatedArray:
    """The mirrors: ``trigger`` is their input, ``on_shown`` receives each finished frame."""

    def __init__(self, clock: VirtualClock, model: ArrayModel = ArrayModel()) -> None:
        self.clock = clock
        self.model = model
        self.on_shown: Callable[[DisplayedFrame], None] | None = None
        self.counts: dict[str, int] = {"shown": 0, "missed": 0, "empty": 0, "uploaded": 0, "upload_bytes": 0}
        self.removed = False
        self.slave = self.queueing = False
        self.time_out = True
        self._queue: deque[Queued] = deque()
        self._current: tuple[DisplayedFrame, int] | None = None
        self._last_trigger = 0
        clock.attach(self)

    def trigger(self, now: int) -> None:
        """An edge at the trigger input."""
        self.advance(now)
        self._last_trigger = now
        if not self.slave or self.removed:
            return
        if self._current is not None and now < self._current[1]:
            self.counts["missed"] += 1
        elif not self._queue:
            self.counts["empty"] += 1
        else:
            self._finish()
            self._show(now + self._queue[0].stored.delay_us * MICRO)

    def _show(self, start: int) -> None:
        """Start the next frame of the queue at a time [ns]."""
        head = self._queue[0]
        stored, frame = head.stored, head.next
        planes = stored.frames.get(frame)
        if planes is None:
            planes = np.zeros((stored.bits, self.model.height, self.model.row_bytes), np.uint8)
        lit = self._lit_ns(stored)
        levels = 2**stored.bits
        edges = [start + lit * (levels - (levels >> plane)) // (levels - 1) for plane in range(stored.bits + 1)]
        self.counts["shown"] += 1
        shown = DisplayedFrame(
            self.counts["shown"] - 1, head.sequence, frame, planes, tuple(edges[:-1]), tuple(edges[1:])
        )
        period = max(stored.picture_us * MICRO, edges[-1] - start)
        self._current = (shown, start + period)
        head.next += 1
        if head.next > stored.last or head.next >= head.frames:  # `_finish` drops a sequence without iterations
            if head.iterations is not None:
                head.iterations -= 1
            if head.iterations is None or head.iterations > 0:
                head.next = 0

    def _lit_ns(self, stored: Stored) -> int:
        if stored.uninterrupted and stored.bits == 1:
            return stored.picture_us * MICRO
        return max(stored.illuminate_us - self.model.dark_us, 0) * MICRO

    def _finish(self) -> None:
        """End the frame that shows, and drop its sequence if it was its last."""
        if self._current is None:
            return
        shown, _ = self._current
        self._current = None
        if self._queue and self._queue[0].iterations == 0:
            self._queue.popleft()
        if self.on_shown is not None:
            self.on_shown(shown)

    def due(self) -> int | None:
        """End of a frame."""
        if self._current is not None:
            return self._current[1]
        if self.slave and self.time_out and self._queue:
            return self._last_trigger + self.model.time_out_ns
        return None

    def advance(self, now: int) -> None:
        """End finished frames, and in master mode start those that follow."""
        while self._current is not None and self._current[1] <= now:
            end = self._current[1]
            self._finish()
            if not self.slave and self._queue:
                self._show(end)
        waits = self._current is None and self.slave and self.time_out
        if waits and self._queue and now >= self._last_trigger + self.model.time_out_ns:
            self._queue.clear()

    def _cut(self) -> None:
        """Stop the present frame, as a halt does: the rest of it is not shown."""
        if self._current is None:
            self._queue.clear()
            return
        now = self.clock.now()
        shown, _ = self._current
        starts = tuple(min(start, now) for start in shown.starts)
        ends = tuple(max(min(end, now), start) for start, end in zip(starts, shown.ends, strict=True))
        self._queue.clear()
        self._current = (replace(shown, starts=starts, ends=ends), now)
        self._finish()

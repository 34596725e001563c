"""An emulated projector on a video cable: video frames read at refreshes, and their slots lit one refresh later."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from vamgpu.hosts.emulators.clock import VirtualClock

SECOND = 1_000_000_000


@dataclass(frozen=True)
class LitSlot:
    """Levels ``[row, column]``, at most ``top``, that were lit from ``start`` to ``end`` [ns], as slot ``number``."""

    number: int
    levels: np.ndarray
    top: int
    start: int
    end: int


@dataclass(eq=False)
class EmulatedScreen:
    """A window and its projector, which repeats a video frame until a new one arrives."""

    clock: VirtualClock
    size: tuple[int, int]
    rate_hz: float = 60.0
    order: str = "GR"  # colors of a video frame whose planes are shown
    bits: int = 8  # planes of each color
    latency: int = 1  # refreshes
    share: float = 1.0  # lit share of a slot
    on_slot: Callable[[LitSlot], None] | None = None
    hitches: dict[int, int] = field(default_factory=dict)  # video frame → refreshes that its host loses before it

    def __post_init__(self) -> None:
        self._rate = round(self.rate_hz)
        self.repeated: int = 0
        self.video_frames: int = 0
        self._frame = np.zeros((*self.size, 3), np.uint8)
        self._scanned: deque[tuple[int, np.ndarray, bool]] = deque()
        self._refresh = self.clock.now() * self._rate // SECOND + 1
        self._slot = (self._refresh + self.latency) * len(self.order)
        self._fresh = True
        self.closed: bool = False
        self.unplugged: bool = False
        self.clock.attach(self)

    def refresh_time(self, refresh: int) -> int:
        """Time of a refresh [ns]."""
        return -(-refresh * SECOND // self._rate)

    def slot_time(self, slot: int) -> int:
        """Begin of a slot [ns]."""
        return -(-slot * SECOND // (self._rate * len(self.order)))

    def show(self, video_frame: np.ndarray, /) -> int:
        """Accept a video frame for the next refresh, and return at that refresh, as a synchronized window does."""
        if video_frame.shape != (*self.size, 3) or video_frame.dtype != np.uint8:
            raise ValueError(f"video frames are {self.size} x 3 bytes, not {video_frame.shape} {video_frame.dtype}")
        if self.unplugged:
            raise OSError("no such screen")
        wait, self.video_frames = self.hitches.get(self.video_frames, 0), self.video_frames + 1
        if wait:
            self.clock.sleep_until(self.refresh_time(self._refresh + wait - 1))
        self._frame, self._fresh = video_frame.copy(), True
        refresh = self._refresh
        self.clock.sleep_until(self.refresh_time(refresh))
        return refresh

    def unplug(self) -> None:
        """Pull the cable: the projector repeats its last video frame."""
        self.unplugged = True

    def close(self) -> None:
        """Stop showing frames."""
        self.closed = True

    def due(self) -> int | None:
        """The next refresh, or the end of the next slot."""
        if self.closed:
            return None
        return min(self.refresh_time(self._refresh), self.slot_time(self._slot + 1))

    def advance(self, now: int) -> None:
        """Read video frames and light slots."""
        while (at := self.due()) is not None and at <= now:
            if self.slot_time(self._slot + 1) <= at:
                self._light()
            else:
                self._scanned.append((self._refresh, self._frame, self._fresh))
                self.repeated += not self._fresh
                self._fresh = False
                self._refresh += 1

    def _light(self) -> None:
        slots = len(self.order)
        refresh = self._slot // slots - self.latency
        while self._scanned and self._scanned[0][0] < refresh:
            self._scanned.popleft()
        if self._scanned and self.on_slot is not None:
            color = "RGB".index(self.order[self._slot % slots])
            levels = self._scanned[0][1][:, :, color] >> (8 - self.bits)
            start, stop = self.slot_time(self._slot), self.slot_time(self._slot + 1)
            end = start + round((stop - start) * self.share)
            self.on_slot(LitSlot(self._slot, levels, 2**self.bits - 1, start, end))
        self._slot += 1

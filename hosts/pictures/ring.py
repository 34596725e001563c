"""A bounded ring of buffers between one thread that fills them and one that empties them; nobody allocates."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vamgpu.errors import BadInput


@dataclass(frozen=True, eq=False)
class Batch:
    """Pictures of slots first, first + 1, … in a buffer.

    pictures: a view, [picture, …]; valid until the buffer is released.  ready: when they were
    there [ns].
    """

    first: int
    pictures: np.ndarray
    ready: int

    @property
    def end(self) -> int:
        """One after the last slot."""
        return self.first + len(self.pictures)


class Ring:
    """Buffers that go round. ``claim`` and ``commit`` are the filler's, ``head`` and ``release`` the emptier's.

    A full ring makes the filler wait, an empty one the emptier: that is the back-pressure, there is no other.
    """

    def __init__(self, buffers: Sequence[np.ndarray]) -> None:
        if len(buffers) < 2:
            raise BadInput(f"a ring of {len(buffers)} buffers; wanted 2 or more, one to fill and one to empty")
        self._buffers = tuple(buffers)
        self._filled: list[Batch | None] = [None] * len(buffers)
        self._written = self._read = 0
        self._closed = False
        self._change = threading.Condition()

    @property
    def capacity(self) -> int:
        """Buffers."""
        return len(self._buffers)

    @property
    def fill(self) -> int:
        """Buffers that wait to be emptied."""
        return self._written - self._read

    @property
    def closed(self) -> bool:
        """Whether nobody shall wait any more."""
        return self._closed

    def claim(self, timeout: float = 0.0) -> np.ndarray | None:
        """The next buffer to fill; None where all are full for ``timeout`` seconds, or the ring is closed."""
        with self._change:
            self._change.wait_for(lambda: self._closed or self.fill < self.capacity, timeout)
            if self._closed or self.fill >= self.capacity:
                return None
            return self._buffers[self._written % self.capacity]

    def commit(self, batch: Batch) -> None:
        """Hand over the buffer that was claimed."""
        with self._change:
            self._filled[self._written % self.capacity] = batch
            self._written += 1
            self._change.notify_all()

    def head(self, timeout: float = 0.0) -> Batch | None:
        """The oldest pictures; None where there are none for ``timeout`` seconds. They stay until released."""
        with self._change:
            self._change.wait_for(lambda: self._closed or self.fill > 0, timeout)
            return self._filled[self._read % self.capacity] if self.fill else None

    def release(self) -> None:
        """Give back the buffer of ``head``."""
        with self._change:
            if not self.fill:
                raise BadInput("the ring is empty; release what head() gave, once")
            self._filled[self._read % self.capacity] = None
            self._read += 1
            self._change.notify_all()

    def close(self) -> None:
        """Wake and send away whoever waits."""
        with self._change:
            self._closed = True
            self._change.notify_all()

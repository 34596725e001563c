"""Host memory that is allocated once and used again, so that drivers copy from it directly."""

from __future__ import annotations

import mmap
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from vamgpu.backend.device import Device
from vamgpu.errors import BadInput


def pinned_buffers(count: int, shape: tuple[int, ...], device: Device | None = None) -> tuple[np.ndarray, ...]:
    """``count`` arrays uint8 of a shape, set to 0: locked if ``device`` is a GPU, else on separate pages."""
    return tuple(_buffer(shape, device) for _ in range(count))


def _buffer(shape: tuple[int, ...], device: Any) -> np.ndarray:
    if type(device).__name__ == "WarpDevice" and getattr(getattr(device, "_device", None), "is_cuda", False):
        import warp as wp

        return wp.zeros(shape, dtype=wp.uint8, device="cpu", pinned=True).numpy()  # a view, which keeps the memory
    nbytes = max(int(np.prod(shape)), 1)
    if getattr(device, "is_gpu", False) and hasattr(device, "queue"):
        import pyopencl as cl

        owner = cl.Buffer(device.context, cl.mem_flags.READ_WRITE | cl.mem_flags.ALLOC_HOST_PTR, nbytes)
        both: Any = cl.map_flags.READ | cl.map_flags.WRITE
        # the array's base keeps the buffer, and unmaps it at its end
        array, _ = cl.enqueue_map_buffer(device.queue, owner, both, 0, shape, np.dtype(np.uint8))
    else:
        array = np.frombuffer(mmap.mmap(-1, nbytes), np.uint8, int(np.prod(shape))).reshape(shape)
    array[...] = 0  # touch the pages now, not during a print
    return array


@dataclass(frozen=True, eq=False)
class Batch:
    """Frames of slots first, first + 1, … in a buffer."""

    first: int
    frames: np.ndarray  # a view, [frame, …]; valid until the buffer is released
    kept: bool = False  # whether the mirrors already have them, and the buffer is empty

    @property
    def end(self) -> int:
        """One after the last slot."""
        return self.first + len(self.frames)


class BufferRing:
    """A ring of buffers: one side claims and commits, the other takes the head and releases; each waits."""

    def __init__(self, buffers: Sequence[np.ndarray]) -> None:
        if len(buffers) < 2:
            raise BadInput(f"a ring of {len(buffers)} buffers; expected 2 or more, one to fill and one to empty")
        self._buffers = tuple(buffers)
        self._filled: list[Batch | None] = [None] * len(buffers)
        self._written = self._read = 0
        self._closed = False
        self._change = threading.Condition()

    @property
    def capacity(self) -> int:
        return len(self._buffers)

    @property
    def fill(self) -> int:
        """Number of full buffers."""
        return self._written - self._read

    def claim(self, timeout: float = 0.0) -> np.ndarray | None:
        """The next buffer to fill; None if all stay full for ``timeout`` seconds, or the ring is closed."""
        with self._change:
            self._change.wait_for(lambda: self._closed or self.fill < self.capacity, timeout)
            if self._closed or self.fill >= self.capacity:
                return None
            return self._buffers[self._written % self.capacity]

    def commit(self, batch: Batch) -> None:
        """Hand over the claimed buffer."""
        with self._change:
            self._filled[self._written % self.capacity] = batch
            self._written += 1
            self._change.notify_all()

    def head(self, timeout: float = 0.0) -> Batch | None:
        """The oldest frames; None if there are none for ``timeout`` seconds. They stay until released."""
        with self._change:
            self._change.wait_for(lambda: self._closed or self.fill > 0, timeout)
            return self._filled[self._read % self.capacity] if self.fill else None

    def release(self) -> None:
        """Release the buffer of ``head``."""
        with self._change:
            if not self.fill:
                raise BadInput("the ring is empty; release what head() gave, once")
            self._filled[self._read % self.capacity] = None
            self._read += 1
            self._change.notify_all()

    def close(self) -> None:
        """Close the ring, and wake waiting threads."""
        with self._change:
            self._closed = True
            self._change.notify_all()

"""Host memory that is made once, stays in place and is used again: what drivers copy from without a detour."""

from __future__ import annotations

import mmap
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, overload

import numpy as np

from vamgpu.backend.device import Device
from vamgpu.errors import BadInput


class PinnedBuffers(Sequence[np.ndarray]):
    """Arrays uint8 of one shape; their memory is given back once it is closed and its last view is gone."""

    def __init__(self, made: Sequence[tuple[np.ndarray, Any]], locked: bool) -> None:
        self._arrays: tuple[np.ndarray, ...] = tuple(array for array, _ in made)
        self.owners: tuple[Any, ...] = tuple(owner for _, owner in made)
        self.locked = locked

    def __len__(self) -> int:
        return len(self._arrays)

    @overload
    def __getitem__(self, place: int) -> np.ndarray: ...
    @overload
    def __getitem__(self, place: slice) -> tuple[np.ndarray, ...]: ...
    def __getitem__(self, place: int | slice) -> np.ndarray | tuple[np.ndarray, ...]:
        return self._arrays[place]

    def close(self) -> None:
        """Let go of the memory; often is no harm."""
        self._arrays, self.owners = (), ()

    def __enter__(self) -> PinnedBuffers:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def pinned_buffers(count: int, shape: tuple[int, ...], device: Device | None = None) -> PinnedBuffers:
    """``count`` arrays uint8 of a shape, set to 0: locked where ``device`` is a GPU, else whole pages of their own."""
    kind = type(device).__name__
    if kind == "WarpDevice" and getattr(getattr(device, "_device", None), "is_cuda", False):
        return PinnedBuffers([_by_warp(shape) for _ in range(count)], locked=True)
    if getattr(device, "is_gpu", False) and hasattr(device, "queue"):
        return PinnedBuffers([_by_opencl(shape, device) for _ in range(count)], locked=True)
    return PinnedBuffers([_by_pages(shape) for _ in range(count)], locked=False)


def _by_warp(shape: tuple[int, ...]) -> tuple[np.ndarray, Any]:
    import warp as wp

    owner: Any = wp.zeros(shape, dtype=wp.uint8, device="cpu", pinned=True)
    return owner.numpy(), owner  # a view, which keeps the memory


def _by_opencl(shape: tuple[int, ...], device: Any) -> tuple[np.ndarray, Any]:
    import pyopencl as cl

    flags = cl.mem_flags.READ_WRITE | cl.mem_flags.ALLOC_HOST_PTR
    owner = cl.Buffer(device.context, flags, max(int(np.prod(shape)), 1))
    both: Any = cl.map_flags.READ | cl.map_flags.WRITE
    # the array's base keeps the buffer, and unmaps it as it goes
    array, _ = cl.enqueue_map_buffer(device.queue, owner, both, 0, shape, np.dtype(np.uint8))
    array[...] = 0
    return array, owner


def _by_pages(shape: tuple[int, ...]) -> tuple[np.ndarray, Any]:
    owner = mmap.mmap(-1, max(int(np.prod(shape)), 1))
    array = np.frombuffer(owner, np.uint8, int(np.prod(shape))).reshape(shape)
    array[...] = 0  # touched now, not in the middle of a print
    return array, owner


@dataclass(frozen=True, eq=False)
class Batch:
    """Frames of slots first, first + 1, … in a buffer."""

    first: int
    frames: np.ndarray  # a view, [frame, …]; valid until the buffer is released
    ready: int  # when they were there [ns]
    kept: bool = False  # whether the mirrors have them already, and the buffer is empty

    @property
    def end(self) -> int:
        """One after the last slot."""
        return self.first + len(self.frames)


class BufferRing:
    """Buffers that go round: one side claims and commits, the other takes the head and releases; each waits."""

    def __init__(self, pinned_buffers: PinnedBuffers) -> None:
        if len(pinned_buffers) < 2:
            raise BadInput(f"a ring of {len(pinned_buffers)} buffers; expected 2 or more, one to fill and one to empty")
        self._buffers = tuple(pinned_buffers)
        self._filled: list[Batch | None] = [None] * len(pinned_buffers)
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
        """The oldest frames; None where there are none for ``timeout`` seconds. They stay until released."""
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

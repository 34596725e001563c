"""Host memory that is made once, stays in place and is used again: what drivers copy from without a detour."""

from __future__ import annotations

import mmap
from collections.abc import Sequence
from typing import Any, overload

import numpy as np

from vamgpu.backend.device import Device


class Buffers(Sequence[np.ndarray]):
    """Arrays uint8 of one shape, and what their memory belongs to.

    locked: whether their pages are, so that a GPU reads and writes them itself.  owners: Warp arrays, OpenCL buffers or
    maps of pages, one an array.  Memory is unlocked and given back once it is closed, or forgotten, and the last view
    of it is gone: nobody is left with an array whose memory is not there.
    """

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

    def __enter__(self) -> Buffers:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def buffers(count: int, shape: tuple[int, ...], device: Device | None = None) -> Buffers:
    """``count`` arrays uint8 of a shape, set to 0: locked where ``device`` is a GPU, else whole pages of their own."""
    kind = type(device).__name__
    if kind == "WarpDevice" and getattr(getattr(device, "_device", None), "is_cuda", False):
        return Buffers([_by_warp(shape) for _ in range(count)], locked=True)
    if getattr(device, "is_gpu", False) and hasattr(device, "queue"):
        return Buffers([_by_opencl(shape, device) for _ in range(count)], locked=True)
    return Buffers([_by_pages(shape) for _ in range(count)], locked=False)


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

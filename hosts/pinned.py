"""Host memory that is made once, stays in place and is used again: what drivers copy from without a detour."""

from __future__ import annotations

import mmap
from typing import Any

import numpy as np

from vamgpu.backend.device import Device


def buffers(count: int, shape: tuple[int, ...], device: Device | None = None) -> tuple[np.ndarray, ...]:
    """``count`` arrays uint8 of a shape, set to 0: locked where ``device`` is a GPU, else whole pages of their own."""
    return tuple(_buffer(shape, device) for _ in range(count))


def _buffer(shape: tuple[int, ...], device: Device | None) -> np.ndarray:
    kind, there = type(device).__name__, getattr(device, "_device", None)
    if kind == "WarpDevice" and getattr(there, "is_cuda", False):
        import warp as wp

        array: Any = wp.zeros(shape, dtype=wp.uint8, device="cpu", pinned=True)
        return array.numpy()  # the view keeps the memory
    if kind == "OpenclDevice" and getattr(device, "is_gpu", False):
        import pyopencl as cl

        flags = cl.mem_flags.READ_WRITE | cl.mem_flags.ALLOC_HOST_PTR
        opencl: Any = device
        handle = cl.Buffer(opencl.context, flags, int(np.prod(shape)))
        both: Any = cl.map_flags.READ | cl.map_flags.WRITE
        array, _ = cl.enqueue_map_buffer(opencl.queue, handle, both, 0, shape, np.dtype(np.uint8))
        array[...] = 0
        return array
    pages = mmap.mmap(-1, max(int(np.prod(shape)), 1))
    array = np.frombuffer(pages, np.uint8, int(np.prod(shape))).reshape(shape)
    array[...] = 0  # touched now, not in the middle of a print
    return array

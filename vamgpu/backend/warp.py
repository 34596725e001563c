"""NVIDIA GPUs (and any CPU) through Warp."""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from math import prod
from typing import Any

import numpy as np
import warp as wp

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.backend.host_memory import from_host
from vamgpu.backend.kernel_cache import writable
from vamgpu.errors import DeviceError, KernelError, OutOfMemory
from vamgpu.kernels import pointwise
from vamgpu.kernels.catalog import declared
from vamgpu.kernels.signature import Field, Kernel

LANES = 32
STRIDE_LIMIT = 2**31  # warp stores strides and extents in 32 bits
CUDA = 2
"""GPU memory, by its number in DLPack."""
VECTOR = 16  # alignment of vectors in bytes

TYPES: dict[str, type] = {"float32": wp.float32, "int32": wp.int32, "uint8": wp.uint8, "uint32": wp.uint32}


def start() -> None:
    """Start Warp without its banner, and without its message about a missing CUDA driver: libraries don't print."""
    wp.config.log_level = wp.LOG_ERROR
    writable()
    try:
        with _silent_stderr():
            wp.init()
    except OSError as error:
        raise DeviceError(
            f"Warp cannot keep its compiled kernels: {error}; set WARP_CACHE_PATH to a folder that this user may write"
        ) from error


@contextmanager
def _silent_stderr() -> Iterator[None]:
    """Native code writes to file descriptor 2 directly; therefore that descriptor is redirected."""
    with open(os.devnull, "w") as nowhere:
        kept = os.dup(2)
        os.dup2(nowhere.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(kept, 2)
            os.close(kept)


class WarpDevice(Device):
    """One Warp device; fields are arrays ``[slab, major, minor, lanes / 4]`` of vec4."""

    def __init__(self, name: str, device: str) -> None:
        start()
        try:
            self._device = wp.get_device(device)
        except (RuntimeError, ValueError) as error:
            raise DeviceError(f"Warp has no device {device!r} here: {error}") from error
        super().__init__(name, f"{self._device.name} (Warp {wp.config.version})")
        self.is_gpu: bool = bool(self._device.is_cuda)
        if self.is_gpu:
            self.dlpack_device: tuple[int, int] = (CUDA, self._device.ordinal)

    @property
    def real(self) -> np.dtype:
        return np.dtype(np.float32)

    def lanes_for(self, nz: int) -> int:
        return min(LANES, -(-nz // 4) * 4)

    def _allocate(self, shape: tuple[int, ...], dtype: np.dtype, lanes: int) -> wp.array:
        kind: Any = TYPES.get(dtype.name)
        if kind is None:
            raise KernelError(f"{self.name} keeps {', '.join(TYPES)}; got {dtype}")
        if lanes:
            shape, kind = (*shape[:3], shape[3] // 4), wp.vec4
        stride = int(np.prod(shape[1:], dtype=np.int64)) * dtype.itemsize * (4 if lanes else 1)
        if max(shape, default=0) >= STRIDE_LIMIT or stride >= STRIDE_LIMIT:
            raise OutOfMemory(f"{shape} of {dtype} has a stride of {stride} bytes; Warp allows less than 2 GiB: "
                              "use a device of OpenCL, or fewer angles at once")  # fmt: skip
        try:
            return wp.empty(shape, dtype=kind, device=self._device)
        except RuntimeError as error:
            raise OutOfMemory(f"{self.name} has no room for {shape} of {dtype}: {error}") from error

    def borrow(self, values: np.ndarray) -> DeviceArray:
        kind: Any = TYPES.get(values.dtype.name)
        if self._device.is_cuda or kind is None or not values.flags.c_contiguous or not values.flags.writeable:
            return super().borrow(values)
        handle = wp.array(values, dtype=kind, device=self._device, copy=False)
        return DeviceArray(self, handle, values.shape, values.dtype, 0)

    def lend(self, values: np.ndarray) -> DeviceArray | None:
        return None if self._device.is_cuda or not values.flags.c_contiguous else self.borrow(values)

    def _write(self, handle: wp.array, stored: np.ndarray, first: int = 0) -> None:
        seen, first, count = self._host_view(handle, stored, first)
        if count:
            wp.copy(handle, seen, dest_offset=first, count=count)

    def _read(self, handle: wp.array, stored: np.ndarray, first: int = 0) -> None:
        seen, first, count = self._host_view(handle, stored, first)
        if count:
            wp.copy(seen, handle, src_offset=first, count=count)
        self.synchronize()

    def _offer(self, handle: wp.array, taker: Device) -> Any:
        if not isinstance(taker, WarpDevice) or taker._device.is_cuda != self._device.is_cuda:
            return None
        if self._device.is_cuda:
            _let_in(self._device.alias, taker._device.alias)
        return handle, self._device.stream.record_event() if self._device.is_cuda else None

    def _take(self, handle: wp.array, giver: Device, offer: Any) -> None:
        source, ready = offer
        if ready is not None:
            self._device.stream.wait_event(ready)
        wp.copy(handle, source)  # the stream of the giver goes on after it

    @staticmethod
    def _host_view(handle: wp.array, stored: np.ndarray, first: int) -> tuple[wp.array, int, int]:
        """Host memory, and first element and count in the units of the handle."""
        width = 4 if handle.dtype is wp.vec4 else 1
        seen = stored.reshape(-1, 4) if width > 1 else stored.reshape(-1)
        return wp.array(seen, dtype=handle.dtype, device="cpu", copy=False), first // width, stored.size // width

    def _grid(self, kernel: Kernel, shape: tuple[int, int, int]) -> tuple[int, int, int, int]:
        """Threads along (slab, major, minor, lane group)."""
        lanes, tiling = self.lanes_for(shape[2]), kernel.gpu
        minor = -(-shape[1] // tiling.minor) if tiling.minor else 1
        major = -(-shape[0] // tiling.major) if tiling.major else 1
        counts = (-(-shape[2] // (lanes * tiling.slabs)), major, minor)
        if len(tiling.group) == 3:
            counts = tuple(-(-n // g) * g for n, g in zip(counts, self._block(kernel, counts[0], lanes), strict=True))
        return (*counts, lanes // 4)  # type: ignore[return-value]

    def _block(self, kernel: Kernel, slabs: int, lanes: int) -> tuple[int, int, int]:
        """Tiles of a block along (slab, major, minor), cut to whole samples and to the number of slabs."""
        if not self.is_gpu:
            return (1, 1, 1)
        minor, major, blocks = kernel.gpu.group
        return (min(blocks, slabs), major, max(minor // (lanes // 4), 1))

    def items(self, kernel: Kernel, shape: tuple[int, int, int]) -> int:
        return int(np.prod(self._grid(kernel, shape)))

    def _launch(self, kernel: Kernel, bound: dict[str, Any], sizes: dict[str, int], lanes: int) -> None:
        spec = kernel.arguments[kernel.over]
        over = tuple(sizes[axis] if not axis.isdigit() else int(axis) for axis in getattr(spec, "axes", ()))
        grid = self._grid(kernel, over) if isinstance(spec, Field) else over  # type: ignore[arg-type]
        function = sibling(kernel)
        handles = [_seen(value, argument.type) for value, argument in zip(bound.values(), function.adj.args)]  # noqa: B905
        inputs = [*handles, *(sizes[axis] for axis in kernel.axes)]
        block = prod(kernel.gpu.group)
        if len(kernel.gpu.group) == 3:
            block = prod(self._block(kernel, grid[0], lanes)) * grid[3]
        wp.launch(function, dim=grid, inputs=inputs, device=self._device, block_dim=block)

    def synchronize(self) -> None:
        wp.synchronize_device(self._device)

    def capture(self, run: Callable[[], None]) -> Callable[[], None]:
        if not self._device.is_cuda:
            return run
        run()  # modules must be loaded before a capture begins
        with wp.ScopedCapture(self._device) as capture:
            run()
        graph: Any = capture.graph
        return lambda: wp.capture_launch(graph)

    def adopt(self, foreign: Any) -> DeviceArray:
        try:
            if isinstance(foreign, wp.array):
                array: Any = foreign
            elif isinstance(foreign, np.ndarray):
                array = wp.from_dlpack(from_host(self, foreign))
            elif hasattr(foreign, "__dlpack__"):
                array = wp.from_dlpack(foreign)
            elif hasattr(foreign, "__cuda_array_interface__"):
                array = wp.array(foreign, device=self._device, copy=False)
            else:
                raise TypeError("no __dlpack__ and no __cuda_array_interface__")
        except (TypeError, RuntimeError, ValueError, BufferError) as error:
            raise DeviceError(f"{self.name} cannot adopt a {type(foreign).__name__}: {error}") from error
        if array.device != self._device:
            raise DeviceError(f"{self.name} adopts arrays of its own device; got one on {array.device}")
        if array.dtype not in TYPES.values():
            raise DeviceError(
                f"{self.name} adopts arrays of {', '.join(TYPES)}; got {array.dtype.__name__}: cast it first"
            )
        array = array if array.is_contiguous else array.contiguous()
        return DeviceArray(self, array, tuple(array.shape), np.dtype(wp.dtype_to_numpy(array.dtype)), 0)

    def _native(self, table: DeviceArray) -> wp.array:
        return table.handle

    def _exported(self, table: DeviceArray, copy: bool) -> wp.array:
        return wp.clone(table.handle) if copy else table.handle

    def _relaid(self, array: DeviceArray, lanes: int) -> wp.array | None:
        handle, (major, minor, nz) = array.handle, array.shape
        if handle.ptr is None or handle.ptr % VECTOR:
            return None
        kind: Any = wp.vec4 if lanes else wp.float32
        shape = (1, major, minor, lanes // 4) if lanes else (major, minor, nz)
        view: Any = wp.array(ptr=handle.ptr, dtype=kind, shape=shape, device=self._device)
        view._ref = handle  # the memory lives as long as the object that exposes it
        return view


@cache
def _let_in(owner: str, reader: str) -> None:
    """Let a GPU read the memory pool of another one; if it cannot, the driver copies by way of the host."""
    if owner != reader and wp.is_mempool_access_supported(owner, reader):
        wp.set_mempool_access_enabled(owner, reader, True)


def _seen(value: Any, declared: Any) -> Any:
    """A field in the form for its kernel: ``[slab, major, minor, lanes / 4]``, or flat per slab for array2d."""
    if isinstance(value, wp.array) and value.ndim == 4 and declared.ndim == 2:
        return value.reshape((value.shape[0], -1))
    return value


def sibling(kernel: Kernel) -> wp.Kernel:
    """The Warp version of a declared kernel."""
    if kernel.pointwise:
        return _from_definitions(kernel.concept)[kernel.name]
    module = importlib.import_module(f"vamgpu.kernels.{kernel.concept}_warp")
    return getattr(module, kernel.name)


@cache
def _from_definitions(concept: str) -> dict[str, wp.Kernel]:
    """Warp versions of a concept's pointwise kernels, which are compiled together."""
    module: Any = wp.get_module(f"vamgpu.kernels.{concept}_pointwise")
    wp.set_module_options({"enable_backward": False, "fast_math": False}, module)
    names, made = vars(importlib.import_module("vamgpu.kernels.pointwise_warp")), {}
    for kernel in declared(concept):
        if kernel.pointwise:
            text, defined = pointwise.warp(kernel), dict(names)
            exec(text, defined)  # noqa: S102
            made[kernel.name] = wp.Kernel(defined[kernel.name], kernel.name, module, source=text)
    return made

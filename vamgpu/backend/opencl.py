"""OpenCL devices, CPUs and GPUs alike."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
import pyopencl as cl

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.errors import DeviceError, KernelError, OutOfMemory
from vamgpu.kernels.signature import Field, Kernel, Table, Tiling

MOST_TOGETHER = 64
"""Items of a table kernel that PoCL runs together: it keeps the arrays of them all on one stack, and left to choose
takes groups of thousands, which overflow it."""


def _divisor(count: int) -> int:
    """The largest divisor of a count that is no more than `MOST_TOGETHER`."""
    return next(size for size in range(min(count, MOST_TOGETHER), 0, -1) if count % size == 0)


class OpenclDevice(Device):
    """One OpenCL device with one in-order queue.

    CPUs take a whole slab of 16 to 64 lanes per work item; GPUs give each item four lanes, and a slab to eight items.
    """

    def __init__(self, name: str, context: cl.Context) -> None:
        (device,) = context.devices
        super().__init__(name, f"{device.name.strip()} ({device.platform.name})")
        self.is_gpu = bool(device.type & cl.device_type.GPU)
        self.context = context
        self.queue = cl.CommandQueue(context)
        self._device = device
        self._small_groups = "Portable Computing Language" in device.platform.name
        svm = getattr(device, "svm_capabilities", 0)
        self._shares_memory = bool(svm & cl.device_svm_capabilities.FINE_GRAIN_SYSTEM)
        self._compiled = lru_cache(maxsize=None)(self.compile)

    @property
    def real(self) -> np.dtype:
        return np.dtype(np.float32)

    def lanes_for(self, nz: int) -> int:
        if self.is_gpu:
            return min(32, -(-nz // 4) * 4)
        # the widest slab that pads z least
        return min((64, 48, 32, 16), key=lambda lanes: (-(-nz // lanes) * lanes, -lanes))

    def _allocate(self, shape: tuple[int, ...], dtype: np.dtype, lanes: int) -> cl.Buffer:
        nbytes = int(np.prod(shape, dtype=np.int64)) * dtype.itemsize
        limit = self._device.max_mem_alloc_size
        if nbytes > limit:
            raise OutOfMemory(
                f"{shape} of {dtype} needs {nbytes} bytes; {self.name} allocates at most {limit} at once: "
                "use a coarser grid or fewer angles"
            )
        try:
            return cl.Buffer(self.context, cl.mem_flags.READ_WRITE, max(nbytes, 4))
        except cl.Error as error:
            raise OutOfMemory(f"{self.name} has no {nbytes} bytes left for {shape} of {dtype}: {error}") from error

    def borrow(self, values: np.ndarray) -> DeviceArray:
        if self.is_gpu or not values.flags.c_contiguous or not values.nbytes:
            return super().borrow(values)
        handle: Any = cl.SVM(values) if self._shares_memory else None
        if handle is None:  # some drivers copy what does not begin a page
            flags = cl.mem_flags.READ_ONLY | cl.mem_flags.USE_HOST_PTR
            handle = cl.Buffer(self.context, flags, hostbuf=values)
        return DeviceArray(self, handle, values.shape, values.dtype, 0)

    def lend(self, values: np.ndarray) -> DeviceArray | None:
        if not self._shares_memory or self.is_gpu or not values.flags.c_contiguous or not values.nbytes:
            return None
        return self.borrow(values)

    def _write(self, handle: cl.Buffer, stored: np.ndarray) -> None:
        if stored.nbytes:
            cl.enqueue_copy(self.queue, handle, stored)

    def _read(self, handle: cl.Buffer, stored: np.ndarray) -> None:
        if stored.nbytes:
            try:
                cl.enqueue_copy(self.queue, stored, handle)
            except cl.MemoryError as error:  # drivers may defer an allocation until it is first used
                raise OutOfMemory(f"{self.name} ran out of memory: {error}") from error

    def compile(self, kernel: Kernel, lanes: int, *, cached: bool = True) -> cl.Kernel:
        """The sibling of a kernel compiled for a layout of ``lanes``; not cached, it tells its arguments everywhere."""
        options = [f"-I{kernel.source.parent}", "-cl-mad-enable", "-cl-kernel-arg-info"]
        options += [f"-DCOMPILE_{kernel.name}", "-DGPU" if self.is_gpu else "-DCPU"]
        options += [f"-D{key}={value}" for key, value in self._constants(kernel, lanes).items()]
        try:
            with warnings.catch_warnings():  # a compiler that merely talks is no news
                warnings.simplefilter("ignore", cl.CompilerWarning)
                program = cl.Program(self.context, kernel.source.read_text())
                cache: Any = None if cached else False
                return cl.Kernel(program.build(options, cache_dir=cache), kernel.name)
        except (cl.Error, RuntimeError) as error:
            raise KernelError(f"{kernel.source.name} does not build on {self.name}: {error}") from error

    def _constants(self, kernel: Kernel, lanes: int) -> dict[str, int]:
        width = 4 if self.is_gpu else 16
        threads = max(lanes // width, 1) if self.is_gpu else 1  # a kernel over tables alone has no lanes
        tiling = self._tiling(kernel)
        shape = {"LANES": lanes, "WIDTH": width, "THREADS": threads, "VECTORS": lanes // width // threads}
        tile = {"TILE_MAJOR": tiling.major, "TILE_MINOR": tiling.minor, "TILE_SLABS": tiling.slabs}
        return (shape if lanes else {}) | tile | kernel.constants.get("gpu" if self.is_gpu else "cpu", {})

    def _tiling(self, kernel: Kernel) -> Tiling:
        return kernel.gpu if self.is_gpu else kernel.cpu

    def _counts(self, kernel: Kernel, shape: tuple[int, int, int]) -> tuple[int, int, int]:
        """Work items along (minor × threads, major, slab)."""
        lanes, tiling = self.lanes_for(shape[2]), self._tiling(kernel)
        threads = lanes // 4 if self.is_gpu else 1
        minor = -(-shape[1] // tiling.minor) if tiling.minor else 1
        major = -(-shape[0] // tiling.major) if tiling.major else 1
        return (minor * threads, major, -(-shape[2] // (lanes * tiling.slabs)))

    def _group(self, kernel: Kernel, counts: tuple[int, ...], lanes: int) -> tuple[int, int, int]:
        """The work-group as declared, cut to whole samples and to the slabs there are."""
        threads, (minor, major, slabs) = lanes // 4, (*self._tiling(kernel).group, 1)[:3]
        return (max(minor // threads, 1) * threads, major, min(slabs, counts[2]))

    def items(self, kernel: Kernel, shape: tuple[int, int, int]) -> int:
        return int(np.prod(self._counts(kernel, shape)))

    def _launch(self, kernel: Kernel, bound: dict[str, Any], sizes: dict[str, int], lanes: int) -> None:
        spec = kernel.arguments[kernel.over]
        over = tuple(sizes[axis] if not axis.isdigit() else int(axis) for axis in getattr(spec, "axes", ()))
        if isinstance(spec, Field):
            counts: tuple[int, ...] = self._counts(kernel, over)  # type: ignore[arg-type]
            group = self._group(kernel, counts, lanes) if self.is_gpu else (1, 1, 1)
        elif isinstance(spec, Table):
            if 0 in over:
                return
            minor = self._tiling(kernel).minor or over[-1]
            counts = tuple(reversed((*over[:-1], -(-over[-1] // minor))))
            group = (_divisor(counts[0]), *(1 for _ in counts[1:])) if self._small_groups else None
        else:
            raise KernelError(f"{kernel.name} runs over {kernel.over}, which is a number")
        if group:
            counts = tuple(-(-n // g) * g for n, g in zip(counts, group, strict=True))
        function = self._compiled(kernel, lanes)
        extents = [np.int32(sizes[axis]) for axis in kernel.axes]
        try:
            function(self.queue, counts, group, *bound.values(), *extents)
        except cl.MemoryError as error:
            raise OutOfMemory(f"{kernel.name} ran out of memory on {self.name}: {error}") from error
        except cl.Error as error:
            raise KernelError(f"{kernel.name} failed on {self.name}: {error}") from error

    def synchronize(self) -> None:
        self.queue.finish()

    def capture(self, run: Callable[[], None]) -> Callable[[], None]:
        return run

    def adopt(self, foreign: Any) -> DeviceArray:
        data, context = getattr(foreign, "base_data", None), getattr(foreign, "context", None)
        if data is None or context != self.context:
            raise DeviceError(
                f"{self.name} adopts pyopencl arrays of its own context (device.context); "
                f"got {type(foreign).__name__}; upload a NumPy copy instead"
            )
        if foreign.offset or not foreign.flags.c_contiguous:
            raise DeviceError("a pyopencl array must be C contiguous and start its buffer to be adopted; copy it first")
        return DeviceArray(self, data, tuple(foreign.shape), np.dtype(foreign.dtype), 0)

"""OpenCL devices, both CPUs and GPUs."""

from __future__ import annotations

import mmap
import os
import tempfile
import weakref
from collections import deque
from contextlib import suppress
from functools import lru_cache
from hashlib import sha256
from math import prod
from typing import Any

import numpy as np
import pyopencl as cl
import pyopencl.array as cla
from pyopencl.characterize import has_src_build_cache

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.backend.host_memory import from_host
from vamgpu.backend.kernel_cache import keep, kept
from vamgpu.backend.opencl_platforms import NO_CACHE, all_devices, quiet_build
from vamgpu.errors import DeviceError, KernelError, OutOfMemory
from vamgpu.kernels.pointwise import opencl
from vamgpu.kernels.signature import Field, Kernel, Scalar, Table, Tiling

SMALL_TABLE = 1 << 24  # size up to which a table stays in memory, regardless of the memory limit [bytes]
VECTOR = 64  # bytes of the widest vectors that kernels load
FULL_SLAB = 32  # slices of a slab on GPUs, if there are enough; kernels for matrix units are written for it
MOST_TOGETHER = 64
"""Number of items of a table kernel that PoCL runs together: it keeps the arrays of all of them on one stack. By
default it takes groups of thousands, which overflow the stack."""


def _release(queue: cl.CommandQueue, values: Any) -> None:
    """Free host memory when no launched kernel uses it any more."""
    queue.finish()


def _mapped(nbytes: int) -> tuple[np.ndarray, mmap.mmap]:
    """Memory that is an unlinked file, paged by the operating system. Raises `OutOfMemory`."""
    folder = os.environ.get("TMPDIR") or ("/var/tmp" if os.path.isdir("/var/tmp") else None)  # /tmp may be in memory
    try:
        with tempfile.TemporaryFile(dir=folder) as file:
            whole = -(-nbytes // mmap.PAGESIZE) * mmap.PAGESIZE
            if hasattr(os, "posix_fallocate"):  # otherwise a disk that becomes full later kills the process
                os.posix_fallocate(file.fileno(), 0, whole)
            file.truncate(whole)
            mapped = mmap.mmap(file.fileno(), 0)
    except OSError as error:
        raise OutOfMemory(f"no {nbytes} bytes for a file in {folder}: {error}; set TMPDIR to a larger disk") from error
    return np.frombuffer(mapped, np.uint8), mapped


PLACES = 8  # copies to other GPUs that may be under way in pinned memory
PINNED = 1 << 27  # greatest one [bytes]; while a longer one lasts, the host waits
MOST_ENTRIES = 1 << 31  # number of entries of a table that exceeds an int32


class OpenclDevice(Device):
    """An OpenCL device with one in-order queue; an item takes 16 to 64 lanes on a CPU, four on a GPU."""

    def __init__(self, name: str, context: cl.Context, memory: int | None = None) -> None:
        named = all_devices().get(name.partition("@")[0])
        device = next((each for each in context.devices if each == named), context.devices[0])
        super().__init__(name, f"{device.name.strip()} ({device.platform.name})")
        self.is_gpu: bool = bool(device.type & cl.device_type.GPU)
        self.context = context
        self.memory = memory
        """Memory limit of arrays, in bytes, above which further ones are kept in files; None without a limit."""
        self.queue: cl.CommandQueue = cl.CommandQueue(context, device)
        self._device = device
        self._is_nvidia = device.platform.name.startswith("NVIDIA")
        self._has_matrix_units: bool = self._is_nvidia and device.compute_capability_major_nv >= 8
        self._small_groups = "Portable Computing Language" in device.platform.name
        svm = getattr(device, "svm_capabilities", 0)
        self._shares_memory = bool(svm & cl.device_svm_capabilities.FINE_GRAIN_SYSTEM)
        self._places: deque[tuple[np.ndarray, cl.Event]] = deque()  # pinned memory, free after an event
        self._copies: deque[cl.Event] = deque()
        self._compiled = lru_cache(maxsize=None)(self.compile)
        self._planned = lru_cache(maxsize=4096)(self._plan)

    @property
    def real(self) -> np.dtype:
        return np.dtype(np.float32)

    def lanes_for(self, nz: int) -> int:
        if self.is_gpu:
            return min(FULL_SLAB, -(-nz // 4) * 4)
        # the widest slab with the least padding of z
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
            beyond = self.memory is not None and self.ledger.allocated + nbytes > self.memory
            if beyond and (lanes or nbytes > SMALL_TABLE):
                return self._in_file(nbytes)
            return cl.Buffer(self.context, cl.mem_flags.READ_WRITE, max(nbytes, 4))
        except cl.Error as error:
            raise OutOfMemory(f"{self.name} has no {nbytes} bytes left for {shape} of {dtype}: {error}") from error

    def _in_file(self, nbytes: int) -> cl.Buffer:
        """Memory that is an unlinked file; it is freed with the buffer."""
        pages, mapped = _mapped(nbytes)
        weakref.finalize(pages, _release, self.queue, mapped).atexit = False
        return cl.Buffer(self.context, cl.mem_flags.READ_WRITE | cl.mem_flags.USE_HOST_PTR, hostbuf=pages)

    def reserve(self, shape: tuple[int, ...]) -> DeviceArray:
        nbytes, limit = 4 * prod(shape), self._device.max_mem_alloc_size
        if prod(shape) >= MOST_ENTRIES or (nbytes > limit and (self.is_gpu or not self._shares_memory)):
            raise OutOfMemory(
                f"a table of {nbytes} bytes; {self.name} takes at most {limit} at once: use a Projection in place of "
                "rings, a coarser grid or fewer angles"
            )
        if self.is_gpu:
            return super().reserve(shape)
        if self.memory is None or nbytes <= SMALL_TABLE:
            return self.adopt(np.empty(shape, np.float32))
        return self.adopt(_mapped(nbytes)[0][:nbytes].view(np.float32).reshape(shape))

    def borrow(self, values: np.ndarray) -> DeviceArray:
        if self.is_gpu or not values.flags.c_contiguous or not values.nbytes:
            return super().borrow(values)
        return self._over(values, cl.mem_flags.READ_ONLY)

    def _over(self, values: np.ndarray, access: int) -> DeviceArray:
        """A table in a processor's memory that is the NumPy array, or a copy made by the driver."""
        handle: Any = cl.SVM(values) if self._shares_memory else None
        if handle is None:  # some drivers copy memory that does not begin at a page
            handle = cl.Buffer(self.context, access | cl.mem_flags.USE_HOST_PTR, hostbuf=values)
        return DeviceArray(self, handle, values.shape, values.dtype, 0)

    def lend(self, values: np.ndarray) -> DeviceArray | None:
        if not self._shares_memory or self.is_gpu or not values.flags.c_contiguous or not values.nbytes:
            return None
        return self.borrow(values)

    def _write(self, handle: Any, stored: np.ndarray, first: int = 0) -> None:
        if isinstance(handle, cl.SVM):
            self.queue.finish()
            handle.mem.reshape(-1)[first : first + stored.size] = stored.reshape(-1)
        elif stored.nbytes:
            cl.enqueue_copy(self.queue, handle, stored, dst_offset=first * stored.itemsize)

    def _read(self, handle: Any, stored: np.ndarray, first: int = 0) -> None:
        if isinstance(handle, cl.SVM):
            self.queue.finish()
            stored.reshape(-1)[...] = handle.mem.reshape(-1)[first : first + stored.size]
        elif stored.nbytes:
            try:
                cl.enqueue_copy(self.queue, stored, handle, src_offset=first * stored.itemsize)
            except cl.MemoryError as error:  # drivers may defer an allocation until it is first used
                raise OutOfMemory(f"{self.name} ran out of memory: {error}") from error

    def _offer(self, handle: Any, taker: Device) -> Any:
        if not isinstance(taker, OpenclDevice) or taker.context != self.context or isinstance(handle, cl.SVM):
            return None
        if not self.is_gpu or handle.size > PINNED:
            ready = cl.enqueue_marker(self.queue)
            self.queue.flush()
            return handle, ready
        # NVIDIA's driver has the host wait for a copy between two of its GPUs, but not for copies of pinned memory
        pages, free = self._places.popleft() if len(self._places) >= PLACES else self._pages(handle.size)
        if pages.nbytes < handle.size:
            free.wait()
            pages, free = self._pages(handle.size)
        return pages, self._pinned(pages[: handle.size], handle, free)

    def _take(self, handle: Any, giver: OpenclDevice, offer: Any) -> None:  # pyright: ignore[reportIncompatibleMethodOverride]
        memory, ready = offer
        if isinstance(memory, np.ndarray):
            giver._places.append((memory, self._pinned(handle, memory[: handle.size], ready)))
            return
        done = cl.enqueue_copy(self.queue, handle, memory, wait_for=[ready])
        self.queue.flush()
        cl.enqueue_barrier(giver.queue, wait_for=[done])

    def _pinned(self, target: Any, source: Any, after: cl.Event) -> cl.Event:
        """Begin to copy from or to pinned memory."""
        done: Any = cl.enqueue_copy(self.queue, target, source, is_blocking=False, wait_for=[after])
        self.queue.flush()
        self._copies.append(done)  # PyOpenCL waits for copies of host memory whose events are dropped
        while self._copies and self._copies[0].command_execution_status == cl.command_execution_status.COMPLETE:
            self._copies.popleft()
        return done

    def _pages(self, nbytes: int) -> tuple[np.ndarray, cl.Event]:
        """Pinned memory, and the event after which it is free."""
        access: Any = cl.map_flags.READ | cl.map_flags.WRITE
        buffer = cl.Buffer(self.context, cl.mem_flags.READ_WRITE | cl.mem_flags.ALLOC_HOST_PTR, nbytes)
        mapped: Any = cl.enqueue_map_buffer(self.queue, buffer, access, 0, (nbytes,), np.dtype(np.uint8))
        return mapped

    def compile(
        self, kernel: Kernel, lanes: int, fixed: tuple[tuple[str, int], ...] = (), *, cached: bool = True
    ) -> cl.Kernel:
        """A kernel for a layout of ``lanes`` and fixed numbers; uncached ones always report their arguments."""
        options = [f"-I{kernel.source.parent}", "-cl-mad-enable", "-cl-kernel-arg-info"]
        options += [f"-DCOMPILE_{kernel.name}", "-DGPU" if self.is_gpu else "-DCPU"]
        constants = self._constants(kernel, lanes) | {name.upper(): value for name, value in fixed if value}
        options += [f"-D{key}={value}" for key, value in constants.items()]
        if self._kind(kernel, lanes) == "nvidia":
            options.append("-DMATRIX_UNITS")
        registers = self._tiling(kernel, lanes).registers
        if self._is_nvidia and registers:
            options.append(f"-cl-nv-maxrregcount={registers}")
        try:
            with quiet_build():
                function = cl.Kernel(self._built(kernel, options, cached), kernel.name)
                function.set_scalar_arg_dtypes(_numbers(kernel))
                return function
        except (cl.Error, RuntimeError) as error:
            raise KernelError(f"{kernel.name} does not build on {self.name}: {error}") from error

    def _built(self, kernel: Kernel, options: list[str], cached: bool) -> cl.Program:
        """A kernel's program, by the binary of an earlier process if the driver does not keep binaries itself."""
        text, device = opencl(kernel), self._device
        program = cl.Program(self.context, text)
        if not cached or has_src_build_cache(device):
            return program.build(options, devices=[device], cache_dir=NO_CACHE)
        files = (path.read_bytes() for path in sorted(kernel.source.parent.glob("*.h")))
        driver = (device.platform.version, device.name, device.driver_version)
        key = sha256(repr((*driver, options, text, *files)).encode())
        binary = kept(key.hexdigest())
        if binary is not None:
            with suppress(cl.Error, RuntimeError):  # a binary that the driver refuses is made again
                return cl.Program(self.context, [device], [binary]).build(options)
        built: Any = program.build(options, devices=[device], cache_dir=NO_CACHE)
        place = built.get_info(cl.program_info.DEVICES).index(device)
        keep(key.hexdigest(), built.get_info(cl.program_info.BINARIES)[place])
        return built

    def _constants(self, kernel: Kernel, lanes: int) -> dict[str, int]:
        width = 4 if self.is_gpu else 16
        threads = max(lanes // width, 1) if self.is_gpu else 1  # a kernel that runs over tables has no lanes
        tiling = self._tiling(kernel, lanes)
        shape = {"LANES": lanes, "WIDTH": width, "THREADS": threads, "VECTORS": lanes // width // threads}
        tile = {"TILE_MAJOR": tiling.major, "TILE_MINOR": tiling.minor, "TILE_SLABS": tiling.slabs}
        constants = dict(kernel.constants.get(self._kind(kernel, lanes), {}))
        if "HELD" in constants:  # vectors in local memory
            constants["HELD"] = min(constants["HELD"], self._device.local_mem_size // (4 * width))
        return (shape if lanes else {}) | tile | constants

    def _kind(self, kernel: Kernel, lanes: int) -> str:
        """The tiling and constants of a kernel for this device."""
        if self._has_matrix_units and kernel.nvidia and lanes == FULL_SLAB:
            return "nvidia"
        return "gpu" if self.is_gpu else "cpu"

    def _tiling(self, kernel: Kernel, lanes: int) -> Tiling:
        return getattr(kernel, self._kind(kernel, lanes))

    def _counts(self, kernel: Kernel, shape: tuple[int, int, int]) -> tuple[int, int, int]:
        """Work items along (minor × threads, major, slab)."""
        lanes = self.lanes_for(shape[2])
        tiling = self._tiling(kernel, lanes)
        threads = lanes // 4 if self.is_gpu else 1
        minor = -(-shape[1] // tiling.minor) if tiling.minor else 1
        major = -(-shape[0] // tiling.major) if tiling.major else 1
        if self._kind(kernel, lanes) == "nvidia":
            major = shape[0] // tiling.major + 1  # frequencies share entries in pairs, except the first and middle ones
        return (minor * threads, major, -(-shape[2] // (lanes * tiling.slabs)))

    def _group(self, kernel: Kernel, counts: tuple[int, ...], lanes: int) -> tuple[int, int, int]:
        """The declared work-group, cut to whole samples and to the number of slabs."""
        threads, (minor, major, slabs) = lanes // 4, (*self._tiling(kernel, lanes).group, 1)[:3]
        whole = self._kind(kernel, lanes) == "nvidia"  # its items share the loading of data
        return (max(minor // threads, 1) * threads, major, slabs if whole else min(slabs, counts[2]))

    def items(self, kernel: Kernel, shape: tuple[int, int, int]) -> int:
        return int(np.prod(self._counts(kernel, shape)))

    def _launch(self, kernel: Kernel, bound: dict[str, Any], sizes: dict[str, int], lanes: int) -> None:
        extents = [sizes[axis] for axis in kernel.axes]
        fixed = tuple([(name, int(bound[name])) for name in kernel.fixed])
        function, counts, group = self._planned(kernel, lanes, fixed, tuple(extents))
        if 0 in counts:
            return
        try:
            function(self.queue, counts, group, *bound.values(), *extents)
        except cl.MemoryError as error:
            raise OutOfMemory(f"{kernel.name} ran out of memory on {self.name}: {error}") from error
        except cl.Error as error:
            raise KernelError(f"{kernel.name} failed on {self.name}: {error}") from error

    def _plan(
        self, kernel: Kernel, lanes: int, fixed: tuple[tuple[str, int], ...], extents: tuple[int, ...]
    ) -> tuple[cl.Kernel, tuple[int, ...], tuple[int, ...] | None]:
        """The compiled kernel for lengths of its axes, its work items and its groups."""
        spec, sizes = kernel.arguments[kernel.over], dict(zip(kernel.axes, extents, strict=True))
        over = tuple(sizes[axis] if not axis.isdigit() else int(axis) for axis in getattr(spec, "axes", ()))
        function = self._compiled(kernel, lanes, fixed)
        if isinstance(spec, Field):
            counts: tuple[int, ...] = self._counts(kernel, over)  # type: ignore[arg-type]
            group = self._group(kernel, counts, lanes) if self.is_gpu else (1, 1, 1)
        elif isinstance(spec, Table):
            if 0 in over:
                return function, over, None
            minor = self._tiling(kernel, lanes).minor or over[-1]
            counts = tuple(reversed((*over[:-1], -(-over[-1] // minor))))
            count = counts[0]  # PoCL gets its largest divisor that is small enough
            size = next(each for each in range(min(count, MOST_TOGETHER), 0, -1) if count % each == 0)
            group = (size, *(1 for _ in counts[1:])) if self._small_groups else None
        else:
            raise KernelError(f"{kernel.name} runs over {kernel.over}, which is a number")
        if group:
            counts = tuple(-(-n // g) * g for n, g in zip(counts, group, strict=True))
        return function, counts, group

    def flush(self) -> None:
        self.queue.flush()

    def synchronize(self) -> None:
        self.queue.finish()

    def adopt(self, foreign: Any) -> DeviceArray:
        if isinstance(foreign, cla.Array):
            return self._adopt_buffer(foreign)
        if self.is_gpu:
            raise DeviceError(
                f"{self.name} adopts pyopencl arrays of its own context (device.context); "
                f"got {type(foreign).__name__}; upload a NumPy copy, or use device='cuda' to share CUDA's arrays"
            )
        values = from_host(self, foreign)
        if not values.nbytes:
            return self.upload(values, table=True)
        table = self._over(values, cl.mem_flags.READ_WRITE)
        weakref.finalize(table, _release, self.queue, values).atexit = False
        return table

    def _adopt_buffer(self, foreign: cla.Array) -> DeviceArray:
        if foreign.context != self.context:
            raise DeviceError(
                f"{self.name} adopts pyopencl arrays of its own context (device.context); this one has "
                f"{foreign.context}; upload a NumPy copy instead"
            )
        if not foreign.flags.c_contiguous:
            raise DeviceError("a pyopencl array must be C contiguous to be adopted; copy it first")
        foreign.finish()  # it may be computed on another queue
        whole = foreign.copy() if foreign.offset else foreign
        return DeviceArray(self, whole.base_data, tuple(whole.shape), np.dtype(whole.dtype), 0)

    def _native(self, table: DeviceArray) -> Any:
        if isinstance(table.handle, cl.SVM):
            return cla.to_device(self.queue, table.handle.mem)
        return cla.Array(self.queue, table.shape, table.dtype, data=table.handle)

    def _exported(self, table: DeviceArray, copy: bool) -> np.ndarray:
        if copy or not table.nbytes:
            return table.numpy()
        if isinstance(table.handle, cl.SVM):
            self.synchronize()
            return table.handle.mem
        access: Any = cl.map_flags.READ | cl.map_flags.WRITE
        mapped, _ = cl.enqueue_map_buffer(self.queue, table.handle, access, 0, table.shape, table.dtype)
        return mapped

    def _relaid(self, array: DeviceArray, lanes: int) -> Any:
        """Whether memory is aligned for vectors, as in a driver's buffers; memory of other libraries may not be."""
        handle, theirs = array.handle, None
        if isinstance(handle, cl.SVM):
            theirs = handle.mem
        elif handle.flags & cl.mem_flags.USE_HOST_PTR:
            theirs = handle.hostbuf
        lies = theirs is None or (isinstance(theirs, np.ndarray) and theirs.ctypes.data % VECTOR == 0)
        return handle if lies else None


def _numbers(kernel: Kernel) -> list[np.dtype | None]:
    """Types of the arguments that are numbers, None for arrays; a launch takes half of the time if they are known."""
    declared = [np.dtype(spec.dtype) if isinstance(spec, Scalar) else None for spec in kernel.arguments.values()]
    return [*declared, *[np.dtype(np.int32)] * len(kernel.axes)]

"""The base of all devices; each subclass has its own file, and every method here is either abstract or final."""

from __future__ import annotations

import weakref
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager
from math import prod
from typing import Any, final

import numpy as np

from vamgpu.backend import open_device
from vamgpu.backend.array import DeviceArray
from vamgpu.backend.cores import ahead
from vamgpu.backend.host_memory import fetched, from_dlpack, from_host, to_read
from vamgpu.backend.ledger import Ledger
from vamgpu.errors import BadInput, DeviceError, KernelError, ShapeMismatch
from vamgpu.kernels.inhibition import put_poses, take_poses
from vamgpu.kernels.lanes import from_lanes, to_lanes
from vamgpu.kernels.signature import Field, Kernel, Scalar, Table
from vamgpu.kernels.update import linear

STRIP = 1 << 23  # bytes that a thread converts to another layout at a time: fields may be larger than the free memory
HOST = (1, 0)  # host memory, by its number in DLPack


class Device(ABC):
    """A device that runs kernels. Its transfers, ``upload`` and ``download``, are recorded in ``ledger``."""

    is_gpu = False
    """Whether it is a graphics processor with its own memory."""
    dlpack_device: tuple[int, int] = HOST
    """Type and number, in DLPack, of the memory in which arrays are exported."""

    def __init__(self, name: str, description: str) -> None:
        self.name = name
        self.description = description
        self.ledger: Ledger = Ledger()

    def __repr__(self) -> str:
        return f"Device({self.name!r}: {self.description})"

    def __str__(self) -> str:
        return self.name

    @final
    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the name, from which another process opens its own device; raises `DeviceError` without one."""
        try:
            is_named = open_device(self.name) is self
        except DeviceError:
            is_named = False
        if not is_named:
            raise DeviceError(f"got {self!r} to pickle, but no other process can open it by name; expected a device of "
                              "vamgpu.open_device: pickle what it computed as NumPy arrays")  # fmt: skip
        return open_device, (self.name,)

    @final
    def __deepcopy__(self, memo: Any) -> Device:
        return self

    @abstractmethod
    def lanes_for(self, nz: int) -> int:
        """Lanes of the layout for fields of ``nz`` slices; 0 for the plain layout."""

    @abstractmethod
    def _allocate(self, shape: tuple[int, ...], dtype: np.dtype, lanes: int) -> Any:
        """A handle of uninitialized memory; ``shape`` is the stored shape."""

    @abstractmethod
    def _write(self, handle: Any, stored: np.ndarray, first: int = 0) -> None:
        """Copy a contiguous host array into a handle, starting at its element ``first``."""

    @abstractmethod
    def _read(self, handle: Any, stored: np.ndarray, first: int = 0) -> None:
        """Copy the contents of a handle, from its element ``first`` on, into a contiguous host array."""

    @abstractmethod
    def _launch(self, kernel: Kernel, bound: dict[str, Any], sizes: dict[str, int], lanes: int) -> None:
        """Run a kernel on handles and scalars that already match its declaration."""

    def _offer(self, handle: Any, taker: Device) -> Any:
        """Offer a handle, as launched work leaves it, to `_take` of another device; None if only the host could."""
        return None

    def _take(self, handle: Any, giver: Device, offer: Any) -> None:
        """Copy what another device offers into a handle, in order with both queues; offers are taken once, in order."""
        raise DeviceError(f"{self.name} takes nothing from {giver.name}")

    def flush(self) -> None:
        """Start launched work if a driver would otherwise wait for more."""
        return

    @abstractmethod
    def synchronize(self) -> None:
        """Wait until all launched work has run."""

    def adopt(self, foreign: Any) -> DeviceArray:
        """A foreign array on this device (own library, DLPack) as a table, without a copy. Raises `DeviceError`."""
        return self.upload(from_host(self, foreign), table=True)  # of devices that share no memory with this process

    @abstractmethod
    def _native(self, table: DeviceArray) -> Any:
        """A plain table in the form of the device's own library, sharing memory."""

    def _exported(self, table: DeviceArray, copy: bool) -> Any:
        """An object that exports a plain table by DLPack, sharing memory with it or not."""
        return table.numpy()

    def _relaid(self, array: DeviceArray, lanes: int) -> Any:
        """A handle of the same memory for another number of lanes, with the same contents; None if impossible."""
        return None

    @abstractmethod
    def items(self, kernel: Kernel, shape: tuple[int, int, int]) -> int:
        """Number of work items in a launch over a field of this shape; the size of tables of partial results."""

    def capture(self, run: Callable[[], None]) -> Callable[[], None]:
        """A replay of every launch that ``run`` makes: a CUDA graph if available, otherwise ``run`` itself."""
        return run

    @property
    @abstractmethod
    def real(self) -> np.dtype:
        """Floating-point type of fields."""

    @final
    def stored_shape(self, shape: tuple[int, ...], lanes: int) -> tuple[int, ...]:
        """Shape in memory: [slab, major, minor, lane] for a field, padding included; a table keeps its own."""
        if not lanes:
            return shape
        major, minor, nz = shape
        return (-(-nz // lanes), major, minor, lanes)

    @final
    def stored_bytes(self, shape: tuple[int, ...], dtype: np.dtype, lanes: int) -> int:
        """Bytes in memory, padding included."""
        return int(np.prod(self.stored_shape(shape, lanes), dtype=np.int64)) * dtype.itemsize

    @final
    def empty(self, shape: tuple[int, ...], dtype: Any = None, *, table: bool = False) -> DeviceArray:
        """An uninitialized field ``[major, minor, z]``, or a table of any shape and type."""
        kind = np.dtype(dtype) if dtype is not None else self.real
        lanes = 0 if table else self.lanes_for(shape[2])
        handle = self._allocate(self.stored_shape(shape, lanes), kind, lanes)
        array = DeviceArray(self, handle, tuple(shape), kind, lanes)
        self.ledger.take(array.nbytes)
        weakref.finalize(array, self.ledger.give, array.nbytes)
        return array

    @final
    def upload(self, values: Any, dtype: Any = None, *, table: bool = False) -> DeviceArray:
        """Copy an array to the device. Raises `BadInput` for numbers that float32 or dtype cannot hold, and for NaN."""
        source = np.asarray(values)
        return self.gather(source.shape, [source], dtype, table=table)

    @final
    def gather(
        self, shape: tuple[int, ...], parts: Iterable[np.ndarray], dtype: Any = None, *, table: bool = False
    ) -> DeviceArray:
        """A field or a table from successive parts of its entries along the first axis; otherwise as `upload`."""
        if not table and len(shape) != 3:
            raise BadInput(f"a field has 3 axes; got an array of shape {shape}")
        array, first, most = None, 0, 0.0
        for source in parts:
            if source.dtype.kind not in "fiub":
                raise BadInput(f"the array holds {source.dtype}; expected real numbers")
            if not _finite(source):
                raise BadInput("the array holds NaN or infinity; clean it before uploading")
            if array is None:
                array = self.empty(
                    shape, dtype if dtype is not None else (source.dtype if table else None), table=table
                )
                self.ledger.cross("upload", array.nbytes)
            most = max(most, _checked(source, array.dtype))
            self._store(array, source, first)
            first += source.shape[0] if source.ndim else 1
        if array is None or first != (shape[0] if shape else 1):
            raise ShapeMismatch(f"got {first} entries along the first axis; expected those of {shape}")
        least = float(np.finfo(np.float32).tiny)
        if 0.0 < most < least:
            raise BadInput(
                f"the greatest number of the array is {most:.3g}, which float32 rounds to 0; expected "
                f"{least:.3g} or more: scale it"
            )
        return array

    @final
    def restored(self, values: np.ndarray, table: bool) -> DeviceArray:
        """The previously downloaded array if its values are the same to the last bit, including NaN."""
        array = self.empty(values.shape, values.dtype, table=table)
        self.ledger.cross("upload", array.nbytes)
        self._store(array, values)
        return array

    def _store(self, array: DeviceArray, source: np.ndarray, first: int = 0) -> None:
        """Copy a NumPy array of any layout and type into entries of the first axis from ``first`` on."""
        lanes = array.lanes
        if not lanes:
            return self._write(array.handle, np.ascontiguousarray(source, array.dtype), first * prod(array.shape[1:]))
        slabs, major, minor, _ = self.stored_shape(array.shape, lanes)
        if self.is_gpu and array.dtype == self.real:  # the device rearranges faster than the host
            for begin, end in _strips(0, len(source), minor * array.shape[2] * array.dtype.itemsize):
                part = self.empty((end - begin, *array.shape[1:]))
                plain = self.empty(part.shape, table=True)
                self._write(plain.handle, np.ascontiguousarray(source[begin:end], array.dtype))
                self.launch(to_lanes, plain=plain, field=part)
                self.launch(put_poses, part=part, first=first + begin, light=array)
            return None

        def laid(place: tuple[int, int, int]) -> tuple[int, np.ndarray]:
            begin, end, slab = place
            strip = np.empty((end - begin, minor, lanes), array.dtype)
            part = source[begin:end, :, slab * lanes : (slab + 1) * lanes]
            strip[..., : part.shape[2]] = part
            strip[..., part.shape[2] :] = 0
            return (slab * major + first + begin) * minor * lanes, strip

        strips = _strips(0, len(source), minor * lanes * array.dtype.itemsize)
        for place, strip in ahead(laid, [(*strip, slab) for strip in strips for slab in range(slabs)]):
            self._write(array.handle, strip, place)

    def _load(self, array: DeviceArray, first: int = 0, last: int | None = None) -> np.ndarray:
        """A NumPy copy in logical shape, of the entries of the first axis from ``first`` to before ``last``."""
        last = (array.shape[0] if array.shape else 1) if last is None else last
        shape = (last - first, *array.shape[1:]) if array.shape else ()
        logical, lanes = np.empty(shape, array.dtype), array.lanes
        if not lanes:
            self._read(array.handle, logical, first * prod(array.shape[1:]))
            return logical
        slabs, major, minor, _ = self.stored_shape(array.shape, lanes)
        if self.is_gpu and array.dtype == self.real:
            for begin, end in _strips(first, last, minor * array.shape[2] * array.dtype.itemsize):
                part = self.empty((end - begin, *array.shape[1:]))
                plain = self.empty(part.shape, table=True)
                self.launch(take_poses, light=array, first=begin, part=part)
                self.launch(from_lanes, field=part, plain=plain)
                self._read(plain.handle, logical[begin - first : end - first])
            return logical

        def strips() -> Iterator[tuple[np.ndarray, np.ndarray]]:
            for begin, end in _strips(first, last, minor * lanes * array.dtype.itemsize):
                for slab in range(slabs):
                    strip = np.empty((end - begin, minor, lanes), array.dtype)
                    self._read(array.handle, strip, (slab * major + begin) * minor * lanes)
                    part = logical[begin - first : end - first, :, slab * lanes : (slab + 1) * lanes]
                    yield part, strip[..., : part.shape[2]]

        for _ in ahead(lambda pair: np.copyto(*pair), strips()):
            pass
        return logical

    @final
    def field(self, values: Any) -> DeviceArray:
        """A field, only for reading, of any array that `adopt` takes. Raises `BadInput`, `DeviceError`."""
        if isinstance(values, DeviceArray):
            self.check_mine(values)
            return self._in_lanes(values)
        if isinstance(values, np.ndarray) or not (hasattr(values, "__dlpack__") or hasattr(values, "base_data")):
            return self.upload(values)
        on_host = tuple(getattr(values, "__dlpack_device__", lambda: (0, 0))()) == HOST
        try:
            source = to_read(from_dlpack(self, values)) if on_host else values
            table = self.upload(source) if on_host and self.is_gpu else self.adopt(source)
        except DeviceError:
            if (array := fetched(values)) is None:
                raise
            return self.upload(array)
        return self._in_lanes(table)

    def _in_lanes(self, array: DeviceArray) -> DeviceArray:
        if array.dtype != self.real and not self.is_gpu:
            array = self.adopt(np.from_dlpack(array).astype(self.real))
        if len(array.shape) != 3 or array.dtype != self.real:
            raise BadInput(
                f"got {array!r}; a field on {self.name} has three axes of {self.real}: cast or reshape it first"
            )
        lanes = self.lanes_for(array.shape[2])
        if array.lanes == lanes:
            return array
        handle = self._relaid(array, lanes) if array.shape[2] == lanes else None
        if handle is not None:
            return DeviceArray(self, handle, array.shape, array.dtype, lanes, array)
        out = self.empty(array.shape)
        self.launch(to_lanes, plain=array, field=out)
        return out

    @final
    def plain(self, array: DeviceArray) -> DeviceArray:
        """A field as a table in C order; shares memory if one slab holds exactly all slices."""
        self.check_mine(array)
        shared = self._shared(array)
        if shared is not None:
            return shared
        out = self.empty(array.shape, array.dtype, table=True)
        self.launch(from_lanes, field=array, plain=out)
        return out

    def _shared(self, array: DeviceArray) -> DeviceArray | None:
        """The same memory as a table; None if the layout in slabs prevents it."""
        if not array.lanes:
            return array
        handle = self._relaid(array, 0) if array.shape[2] == array.lanes else None
        return None if handle is None else DeviceArray(self, handle, array.shape, array.dtype, 0, array)

    @final
    def put(self, values: Any, out: DeviceArray) -> None:
        """Copy an array, as for `field`, into a field of the same shape."""
        source = self.field(values)
        self.launch(linear, a=1.0, x=source, b=0.0, y=source, floor=-3e38, out=out)

    @final
    def native(self, array: DeviceArray) -> Any:
        """See `DeviceArray.native`."""
        return self._native(self.plain(array))

    @final
    def export(self, array: DeviceArray, stream: Any, version: Any, where: Any, copy: bool | None) -> Any:
        """A DLPack capsule of an array; see the protocol for the arguments. Raises `BufferError`."""
        self.check_mine(array)
        there = self.dlpack_device if where is None else tuple(map(int, where))
        if there not in (HOST, self.dlpack_device):
            raise BufferError(f"{self.name} exports to {self.dlpack_device} and to host memory; got {where}")
        fetched = there != self.dlpack_device or (self.is_gpu and there == HOST)
        shared = None if fetched else self._shared(array)
        if shared is None and copy is False:
            raise BufferError(f"{array!r} cannot be exported without a copy; leave out copy=False")
        if fetched:
            return array.numpy().__dlpack__(max_version=version)
        exported = self._exported(shared or self.plain(array), bool(copy) and shared is not None)
        known = {"max_version": version} if isinstance(exported, np.ndarray) else {}
        return exported.__dlpack__(stream=stream, **known)

    def borrow(self, values: np.ndarray) -> DeviceArray:
        """A read-only table, if possible the array itself, which must not change before `synchronize` returns."""
        return self.upload(values, table=True)

    def hold(self, table: DeviceArray) -> DeviceArray:
        """A table as one of this device: its own, or its first member's."""
        return table

    def reserve(self, shape: tuple[int, ...]) -> DeviceArray:
        """An uninitialized table of float32, which may be as large as fields, and in a file if fields may be."""
        return self.empty(shape, self.kept("float32"), table=True)

    def lend(self, values: np.ndarray) -> DeviceArray | None:
        """A table that is the array itself, written when `synchronize` returns; None if no memory is shared."""
        return None

    @final
    def download(self, array: DeviceArray, out: np.ndarray | None = None) -> np.ndarray:
        """A NumPy copy of a device array in logical shape; a table's copy may go to ``out``, C contiguous."""
        self.check_mine(array)
        if out is not None:
            if array.lanes or out.shape != array.shape or out.dtype != array.dtype or not out.flags.c_contiguous:
                raise ShapeMismatch(
                    f"out has shape {out.shape} of {out.dtype}; expected {array.shape} of {array.dtype}, C contiguous"
                )
            self.ledger.cross("download", array.nbytes)
            self._read(array.handle, out)
            return out
        self.ledger.cross("download", array.nbytes)
        return self._load(array)

    @final
    def part(self, array: DeviceArray, first: int, last: int) -> np.ndarray:
        """A NumPy copy of entries of the first axis; see `DeviceArray.part`."""
        self.check_mine(array)
        if not 0 <= first <= last <= array.shape[0]:
            raise BadInput(f"got entries {first} to {last} of the first axis; expected some of {array.shape[0]}")
        self.ledger.cross("download", array.nbytes * (last - first) // max(array.shape[0], 1))
        return self._load(array, first, last)

    @final
    def launch(self, kernel: Kernel, **bindings: Any) -> None:
        """Run a kernel with arguments by name; an array in place of a number gives its lanes. Raises `KernelError`."""
        if bindings.keys() != kernel.arguments.keys():
            raise KernelError(
                f"{kernel.name} takes {', '.join(kernel.arguments)}; got {', '.join(bindings) or 'nothing'}"
            )
        shapes = {n: bindings[n].shape for n, spec in kernel.arguments.items() if not isinstance(spec, Scalar)}
        sizes = kernel.sizes(shapes)
        bound = {name: self._bind(kernel, name, spec, bindings[name]) for name, spec in kernel.arguments.items()}
        self._launch(kernel, bound, sizes, self.lanes_for(sizes["z"]) if "z" in sizes else 0)

    @final
    def _begin(self, kernel: Kernel, given: dict[str, Any]) -> None:
        """Launch a kernel that another device has checked, with arguments in order, and start it."""
        bound, shapes = {}, {}
        for name, spec in kernel.arguments.items():
            value = given[name]
            if not isinstance(value, DeviceArray):
                bound[name] = value
            elif isinstance(spec, Scalar):
                bound[name] = self._lanes_of(value)
            else:
                bound[name], shapes[name] = value.handle, value.shape
        sizes = kernel.sizes(shapes)
        self._launch(kernel, bound, sizes, self.lanes_for(sizes["z"]) if "z" in sizes else 0)
        self.flush()

    def _asked(self, array: DeviceArray, *entries: int | None) -> Callable[[], np.ndarray]:
        """`_load`, as a function that waits for it."""
        return lambda: self._load(array, *entries)  # type: ignore[arg-type]

    def _lanes_of(self, array: DeviceArray) -> Any:
        return np.int32(array.lanes)

    @final
    def _bind(self, kernel: Kernel, name: str, spec: Field | Table | Scalar, value: Any) -> Any:
        if isinstance(spec, Scalar):
            return self._lanes_of(value) if isinstance(value, DeviceArray) else self.kept(spec.dtype).type(value)
        if not isinstance(value, DeviceArray):
            raise KernelError(f"{kernel.name}: {name} is a {type(value).__name__}; upload it to {self.name} first")
        self.check_mine(value)
        expected = self.real if isinstance(spec, Field) else self.kept(spec.dtype)
        if value.dtype != expected or (value.lanes == 0) == (isinstance(spec, Field) and self.lanes_for(1) > 0):
            raise KernelError(f"{kernel.name}: {name} is {value!r}; expected {expected} {type(spec).__name__.lower()}")
        return value.handle

    @final
    def kept(self, dtype: str) -> np.dtype:
        """The type of a declared table type on this device (float32 tables follow the device's real type)."""
        return self.real if dtype == "float32" else np.dtype(dtype)

    @final
    def table(self, values: Any, dtype: str = "float32") -> DeviceArray:
        """Upload a table of a declared type."""
        return self.upload(values, self.kept(dtype), table=True)

    @final
    def check_mine(self, array: DeviceArray) -> None:
        """Raise `DeviceError` for an array of another device."""
        if array.device is not self:
            raise DeviceError(
                f"the array is on {array.device.name}, the work on {self.name}; download it and upload it here"
            )

    @final
    def no_transfers(self) -> AbstractContextManager[None]:
        """Inside, a transfer above 4 kB raises `TransferForbidden`."""
        return self.ledger.forbid()


def _finite(source: np.ndarray) -> bool:
    """Whether all numbers of an array are finite."""
    if source.dtype.kind != "f":
        return True
    if not source.ndim:
        return bool(np.isfinite(source))
    each = source.nbytes // max(len(source), 1)
    return all(ahead(lambda strip: bool(np.isfinite(source[slice(*strip)]).all()), _strips(0, len(source), each)))


def _checked(source: np.ndarray, kind: np.dtype) -> float:
    """Reject numbers that the target type cannot hold; return the greatest one, which might be rounded to 0."""
    if not source.size or source.dtype == kind != np.float64 or source.dtype.kind == "b":
        return 0.0
    low, high = source.min(), source.max()
    if kind.kind in "iu":
        bounds = np.iinfo(kind)
        if low < bounds.min or high > bounds.max:
            raise BadInput(f"the array reaches from {low} to {high}; {kind} holds {bounds.min} to {bounds.max}")
    elif kind.kind == "f" and kind.itemsize >= 4:
        most = max(-float(low), float(high))
        largest = float(np.finfo(np.float32).max)
        if most > largest:
            raise BadInput(f"the array holds {most:.3g}; expected at most {largest:.3g}, as float32 does: scale it")
        return most
    return 0.0


def _strips(first: int, last: int, each: int) -> Iterator[tuple[int, int]]:
    """Number of entries of the first axis that are copied at a time, from the bytes of each."""
    step = max(STRIP // max(each, 1), 1)
    for begin in range(first, last, step):
        yield begin, min(begin + step, last)

"""What every device can do; one subclass a file, and every method here is either abstract or final."""

from __future__ import annotations

import weakref
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, final

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.ledger import Ledger
from vamgpu.errors import BadInput, DeviceError, KernelError, ShapeMismatch
from vamgpu.kernels.signature import Field, Kernel, Scalar, Table


class Device(ABC):
    """A place kernels run. Two doors cross the bus, ``upload`` and ``download``, and both are booked in ``ledger``."""

    is_gpu = False
    """Whether it is a graphics processor, with memory of its own."""

    def __init__(self, name: str, description: str) -> None:
        self.name = name
        self.description = description
        self.ledger = Ledger()

    def __repr__(self) -> str:
        return f"Device({self.name!r}: {self.description})"

    def __str__(self) -> str:
        return self.name

    # ---- abstract: one file a backend -------------------------------------------------------------------------
    @abstractmethod
    def lanes_for(self, nz: int) -> int:
        """Lanes of the layout for fields of ``nz`` slices; 0 for the plain layout."""

    @abstractmethod
    def _allocate(self, shape: tuple[int, ...], dtype: np.dtype, lanes: int) -> Any:
        """A handle of uninitialized memory; ``shape`` is the stored shape."""

    @abstractmethod
    def _write(self, handle: Any, stored: np.ndarray) -> None:
        """Copy a contiguous host array into a handle."""

    @abstractmethod
    def _read(self, handle: Any, stored: np.ndarray) -> None:
        """Copy a handle into a contiguous host array."""

    @abstractmethod
    def _launch(self, kernel: Kernel, bound: dict[str, Any], sizes: dict[str, int], lanes: int) -> None:
        """Run a kernel on handles and scalars that already fit its declaration."""

    @abstractmethod
    def synchronize(self) -> None:
        """Wait until everything launched has run."""

    @abstractmethod
    def adopt(self, foreign: Any) -> DeviceArray:
        """Use a foreign device array as a plain table without a copy, or refuse with `DeviceError` saying why."""

    @abstractmethod
    def items(self, kernel: Kernel, shape: tuple[int, int, int]) -> int:
        """Work items a launch over a field of this shape runs; sizes tables of partial results."""

    @abstractmethod
    def capture(self, run: Callable[[], None]) -> Callable[[], None]:
        """A replay of every launch ``run`` makes: a CUDA graph where there is one, ``run`` itself elsewhere."""

    @property
    @abstractmethod
    def real(self) -> np.dtype:
        """Floating-point type fields are kept in."""

    # ---- final -----------------------------------------------------------------------------------------------
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
        """Copy a NumPy array to the device, as a field or as a table.

        Raises `BadInput` for what is not finite, and for numbers that float32 or the table's type cannot hold. The
        reference, which computes in float64, refuses them too, so that devices agree on what they take.
        """
        source = np.asarray(values)
        if source.dtype.kind not in "fiub":
            raise BadInput(f"the array holds {source.dtype}; wanted real numbers")
        if not table and source.ndim != 3:
            raise BadInput(f"a field has 3 axes; got an array of shape {source.shape}")
        if source.dtype.kind == "f" and not np.isfinite(source).all():
            raise BadInput("the array holds NaN or infinity; clean it before uploading")
        kind = np.dtype(dtype) if dtype is not None else (source.dtype if table else self.real)
        _check_range(source, kind)
        array = self.empty(source.shape, kind, table=table)
        stored = np.zeros(self.stored_shape(source.shape, array.lanes), kind) if array.lanes else None
        if stored is None:
            stored = np.ascontiguousarray(source, kind)
        else:
            _pack(source, stored)
        self.ledger.cross("upload", array.nbytes)
        self._write(array.handle, stored)
        return array

    def borrow(self, values: np.ndarray) -> DeviceArray:
        """A table to read that is the NumPy array itself where device and host share memory, and a copy elsewhere.

        The array must neither change nor go before `synchronize` returns.
        """
        return self.upload(values, table=True)

    def lend(self, values: np.ndarray) -> DeviceArray | None:
        """A table to write that is the NumPy array itself; None where device and host share no memory.

        What was written is there once `synchronize` returns.
        """
        return None

    @final
    def download(self, array: DeviceArray, out: np.ndarray | None = None) -> np.ndarray:
        """A NumPy copy of a device array in logical shape; a table's may go to a like array, C contiguous."""
        self.check_mine(array)
        if out is not None:
            if array.lanes or out.shape != array.shape or out.dtype != array.dtype or not out.flags.c_contiguous:
                raise ShapeMismatch(
                    f"out has shape {out.shape} of {out.dtype}; wanted {array.shape} of {array.dtype}, C contiguous"
                )
            self.ledger.cross("download", array.nbytes)
            self._read(array.handle, out)
            return out
        stored = np.empty(self.stored_shape(array.shape, array.lanes), array.dtype)
        self.ledger.cross("download", array.nbytes)
        self._read(array.handle, stored)
        return _unpack(stored, array.shape) if array.lanes else stored

    @final
    def launch(self, kernel: Kernel, **bindings: Any) -> None:
        """Run ``kernel`` with arguments bound by name; raises `KernelError` for what does not fit the declaration."""
        if set(bindings) != set(kernel.arguments):
            raise KernelError(
                f"{kernel.name} takes {', '.join(kernel.arguments)}; got {', '.join(bindings) or 'nothing'}"
            )
        shapes = {n: bindings[n].shape for n, spec in kernel.arguments.items() if not isinstance(spec, Scalar)}
        sizes = kernel.sizes(shapes)
        bound = {name: self._bind(kernel, name, spec, bindings[name]) for name, spec in kernel.arguments.items()}
        self._launch(kernel, bound, sizes, self.lanes_for(sizes["z"]) if "z" in sizes else 0)

    @final
    def _bind(self, kernel: Kernel, name: str, spec: Field | Table | Scalar, value: Any) -> Any:
        if isinstance(spec, Scalar):
            return self.kept(spec.dtype).type(value)
        if not isinstance(value, DeviceArray):
            raise KernelError(f"{kernel.name}: {name} is a {type(value).__name__}; upload it to {self.name} first")
        self.check_mine(value)
        wanted = self.real if isinstance(spec, Field) else self.kept(spec.dtype)
        if value.dtype != wanted or (value.lanes == 0) == (isinstance(spec, Field) and self.lanes_for(1) > 0):
            raise KernelError(f"{kernel.name}: {name} is {value!r}; wanted {wanted} {type(spec).__name__.lower()}")
        return value.handle

    @final
    def kept(self, dtype: str) -> np.dtype:
        """The type a declared table type is kept in here (float32 tables follow the device's real)."""
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
                f"the array lives on {array.device.name}, the work on {self.name}; download it and upload it here"
            )

    @final
    @contextmanager
    def no_transfers(self) -> Iterator[None]:
        """Inside, a transfer above 4 kB raises `TransferForbidden`."""
        with self.ledger.forbid():
            yield


def _check_range(source: np.ndarray, kind: np.dtype) -> None:
    """Refuse numbers that the target type would turn into infinity, into others, or all of them into nothing."""
    if not source.size or source.dtype == kind != np.float64 or source.dtype.kind == "b":
        return
    low, high = source.min(), source.max()
    if kind.kind in "iu":
        bounds = np.iinfo(kind)
        if low < bounds.min or high > bounds.max:
            raise BadInput(f"the array reaches from {low} to {high}; {kind} holds {bounds.min} to {bounds.max}")
    elif kind.kind == "f" and kind.itemsize >= 4:
        most = max(-float(low), float(high))
        least, largest = float(np.finfo(np.float32).tiny), float(np.finfo(np.float32).max)
        if most > largest:
            raise BadInput(f"the array holds {most:.3g}; expected at most {largest:.3g}, as float32 does: scale it")
        if 0.0 < most < least:
            raise BadInput(
                f"the greatest number of the array is {most:.3g}, which float32 takes for nothing; expected "
                f"{least:.3g} or more: scale it"
            )


def _pack(source: np.ndarray, stored: np.ndarray) -> None:
    slabs, _, _, lanes = stored.shape
    for slab in range(slabs):
        part = source[:, :, slab * lanes : (slab + 1) * lanes]
        stored[slab, :, :, : part.shape[2]] = part


def _unpack(stored: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    logical = np.empty(shape, stored.dtype)
    slabs, _, _, lanes = stored.shape
    for slab in range(slabs):
        part = logical[:, :, slab * lanes : (slab + 1) * lanes]
        part[...] = stored[slab, :, :, : part.shape[2]]
    return logical

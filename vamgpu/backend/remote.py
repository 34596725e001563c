"""A device of another process: orders go to that process, and only data that is read comes back.

Orders are collected until a flush, a read or a query, and sent in batches, one at a time. They are executed in order,
and several devices work at the same time.
"""

from __future__ import annotations

import weakref
from collections import deque
from collections.abc import Callable
from functools import lru_cache
from importlib import import_module
from math import prod
from typing import Any, NamedTuple

import numpy as np

from vamgpu.backend import open_device
from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import STRIP, Device
from vamgpu.backend.host_memory import from_host
from vamgpu.errors import DeviceError, VamError
from vamgpu.kernels.signature import Kernel

Order = tuple[Any, ...]
"""An action and its arguments."""
Send = Callable[[list[Order]], Callable[[], list[Any]]]
"""Function that sends orders and waits for their answers."""


class Facts(NamedTuple):
    """Facts about a device: its name, whether it is a GPU, its floating-point type, and its description."""

    name: str
    is_gpu: bool
    real: str
    description: str


class _Ref(NamedTuple):
    """A handle in the form that orders use."""

    number: int


class Served:
    """A device in the process that has it; None takes the best one. Raises `DeviceError`."""

    def __init__(self, name: str | None) -> None:
        self._device = open_device(name)
        if hasattr(self._device, "members"):
            raise DeviceError(f"got {name!r}, several devices, for a worker; expected one: begin a worker for each")
        self._handles: dict[int, tuple[Any, int]] = {}
        weakref.finalize(self, _let_go, self._handles, self._device).atexit = False

    def facts(self) -> Facts:
        """The device's facts."""
        return Facts(self._device.name, self._device.is_gpu, self._device.real.name, self._device.description)

    def act(self, orders: list[Order]) -> list[Any]:
        """Execute orders in sequence and return the answers. Raises `VamError`; other failures become `DeviceError`."""
        try:
            return [answer for name, *given in orders if (answer := getattr(self, f"_{name}")(*given)) is not None]
        except VamError:
            raise
        except Exception as error:
            raise DeviceError(f"{self._device.name} fails: {type(error).__name__}: {error}") from error

    def _empty(self, number: int, shape: tuple[int, ...], dtype: str, lanes: int) -> None:
        kind = np.dtype(dtype)
        count = prod(shape) * kind.itemsize
        self._handles[number] = self._device._allocate(shape, kind, lanes), count
        self._device.ledger.take(count)

    def _free(self, number: int) -> None:
        _, count = self._handles.pop(number)
        self._device.ledger.give(count)

    def _write(self, number: int, stored: np.ndarray, first: int) -> None:
        self._device._write(self._handles[number][0], stored, first)

    def _read(self, number: int, count: int, dtype: str, first: int) -> np.ndarray:
        stored = np.empty(count, dtype)
        self._device._read(self._handles[number][0], stored, first)
        return stored

    def _launch(self, concept: str, name: str, bound: dict[str, Any], sizes: dict[str, int], lanes: int) -> None:
        kernel = getattr(import_module(f"vamgpu.kernels.{concept}"), name)
        given = {key: self._handles[value.number][0] if isinstance(value, _Ref) else value
                 for key, value in bound.items()}  # fmt: skip
        self._device._launch(kernel, given, sizes, lanes)

    def _items(self, concept: str, name: str, shape: tuple[int, int, int]) -> int:
        return self._device.items(getattr(import_module(f"vamgpu.kernels.{concept}"), name), shape)

    def _lanes(self, nz: int) -> int:
        return self._device.lanes_for(nz)

    def _synchronize(self) -> int:
        self._device.synchronize()
        return 0


def _let_go(handles: dict[int, tuple[Any, int]], device: Device) -> None:
    """Ignore orders whose answers nobody needs any more; the device continues for the next caller."""
    for _, count in handles.values():
        device.ledger.give(count)
    handles.clear()


class _Handle:
    """Memory of the other process."""

    def __init__(self, number: int, dtype: np.dtype) -> None:
        self.number, self.dtype = number, dtype


class RemoteDevice(Device):
    """A device of another process: ``send`` transmits orders to `Served.act` there, or raises `WorkerLost`."""

    def __init__(self, name: str, facts: Facts, send: Send) -> None:
        super().__init__(name, facts.description)
        self.kind: str = facts.name
        """Its name in that process."""
        self.is_gpu: bool = facts.is_gpu
        self._real = np.dtype(facts.real)
        self._send = send
        self._orders: deque[Order] = deque()
        self._waiting = 0
        self._count = 0
        self._answers: Callable[[], list[Any]] | None = None
        self._items = lru_cache(maxsize=None)(lambda concept, name, shape: self._ask(("items", concept, name, shape)))
        self._lanes = lru_cache(maxsize=None)(lambda nz: self._ask(("lanes", nz)))

    @property
    def real(self) -> np.dtype:
        return self._real

    def lanes_for(self, nz: int) -> int:
        return int(self._lanes(nz))

    def items(self, kernel: Kernel, shape: tuple[int, int, int]) -> int:
        return int(self._items(kernel.concept, kernel.name, tuple(shape)))

    # ---- orders ----------------------------------------------------------------------------------------------
    def flush(self) -> None:
        self._wait()
        batch = []
        while self._orders:  # handles freed meanwhile, in any thread, are appended at the end
            batch.append(self._orders.popleft())
        self._waiting = 0
        if batch:
            self._answers = self._send(batch)

    def _wait(self) -> list[Any]:
        answers, self._answers = self._answers, None
        return [] if answers is None else answers()

    def _ask(self, order: Order) -> Any:
        self._wait()
        self._orders.append(order)
        self.flush()
        return self._wait()[-1]

    def synchronize(self) -> None:
        self._ask(("synchronize",))

    # ---- memory ----------------------------------------------------------------------------------------------
    def _allocate(self, shape: tuple[int, ...], dtype: np.dtype, lanes: int) -> _Handle:
        self._count += 1
        handle = _Handle(self._count, dtype)
        self._orders.append(("empty", handle.number, tuple(shape), dtype.name, lanes))
        weakref.finalize(handle, self._orders.append, ("free", handle.number)).atexit = False
        return handle

    def _write(self, handle: _Handle, stored: np.ndarray, first: int = 0) -> None:
        self._orders.append(("write", handle.number, stored.reshape(-1).copy(), first))
        self._waiting += stored.nbytes
        if self._waiting > STRIP:
            self.flush()

    def _read(self, handle: _Handle, stored: np.ndarray, first: int = 0) -> None:
        stored.reshape(-1)[...] = self._ask(("read", handle.number, stored.size, stored.dtype.name, first))

    def _relaid(self, array: DeviceArray, lanes: int) -> None:
        return None

    # ---- work ------------------------------------------------------------------------------------------------
    def _launch(self, kernel: Kernel, bound: dict[str, Any], sizes: dict[str, int], lanes: int) -> None:
        given = {key: _Ref(value.number) if isinstance(value, _Handle) else value for key, value in bound.items()}
        self._orders.append(("launch", kernel.concept, kernel.name, given, sizes, lanes))

    # ---- arrays of other libraries --------------------------------------------------------------------------
    def adopt(self, foreign: Any) -> DeviceArray:
        return self.upload(from_host(self, foreign), table=True)

    def _native(self, table: DeviceArray) -> Any:
        raise DeviceError(f"{self.name} keeps an array in another process, which no library can access; use .numpy()")

    def _exported(self, table: DeviceArray, copy: bool) -> np.ndarray:
        return table.numpy()

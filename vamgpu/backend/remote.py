"""A device of another process: orders go there, and only data that is read comes back.

A thread sends batches, of orders given while the last one was executed; only who asks for an answer waits.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable
from concurrent.futures import Future
from functools import lru_cache
from importlib import import_module
from math import prod
from queue import SimpleQueue
from threading import Thread, current_thread
from typing import Any, NamedTuple

import numpy as np

from vamgpu.backend import open_device
from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import STRIP, Device
from vamgpu.errors import DeviceError, VamError
from vamgpu.kernels.signature import Kernel

Order = tuple[Any, ...]
"""An action and its arguments; futures among them are awaited before it is sent."""
Queued = tuple[Order, Future[Any] | None] | None
"""An order, and the future for its answer if it has one; None ends the thread."""
Send = Callable[[list[Order]], list[Any]]
"""Function that sends orders, each after whether its answer is wanted, and waits for the answers."""
PATIENCE = 1.0  # time in which a thread ends [s]


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
        """Execute orders and return the wanted answers; after a failure, a `VamError`, only free memory."""
        left = iter(orders)
        try:
            each = ((wanted, getattr(self, f"_{name}")(*given)) for wanted, name, *given in left)
            return [answer for wanted, answer in each if wanted]
        except VamError:
            raise
        except Exception as error:
            raise DeviceError(f"{self._device.name} fails: {type(error).__name__}: {error}") from error
        finally:
            for _, name, *given in left:
                if name == "free":
                    self._free(*given)

    def _empty(self, number: int, shape: tuple[int, ...], dtype: str, lanes: int) -> None:
        kind = np.dtype(dtype)
        count = prod(shape) * kind.itemsize
        self._handles[number] = self._device._allocate(shape, kind, lanes), count
        self._device.ledger.take(count)

    def _free(self, number: int) -> None:
        _, count = self._handles.pop(number, (None, 0))  # nothing, if there was no room for it
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


_LATER: Any = object()  # in place of an order: there is none yet


class _Handle:
    """Memory of the other process."""

    def __init__(self, number: int, count: int, dtype: np.dtype) -> None:
        self.number, self.count, self.dtype = number, count, dtype


def _work(orders: SimpleQueue[Queued], send: Send) -> None:
    """Send orders and hand out answers; who asks next is told of a failure."""
    failure: Exception | None = None
    item: Queued = orders.get()
    while item is not None:
        item, failure = _exchange(item, orders, send, failure)
        item = orders.get() if item is _LATER else item


def _exchange(
    item: Queued, orders: SimpleQueue[Queued], send: Send, failure: Exception | None
) -> tuple[Queued, Exception | None]:
    """Send one batch and hand out its answers; return what follows it, and a failure of which nobody was told."""
    batch, futures = list[Order](), list[Future[Any]]()
    while item is not None and item is not _LATER:
        order, future = item
        if batch and any(isinstance(each, Future) and not each.done() for each in order):
            break  # another device may wait for this batch before it answers
        batch.append((future is not None, *order))
        futures += [] if future is None else [future]
        item = orders.get_nowait() if not orders.empty() else _LATER
    try:
        batch = [tuple(each.result() if isinstance(each, Future) else each for each in order) for order in batch]
    except Exception as error:  # noqa: BLE001 - whatever it is, it is told
        failure = failure or error.with_traceback(None)  # which would keep the batch
        batch = [order for order in batch if order[1] == "free"]
    try:
        answers = dict(zip(futures, send(batch), strict=failure is None))
    except Exception as error:  # noqa: BLE001 - as above
        failure, answers = failure or error.with_traceback(None), {}
    for future in futures:
        if failure is None:
            future.set_result(answers[future])
        else:
            future.set_exception(failure)
    return item, None if futures else failure


def _end(orders: SimpleQueue[Queued], thread: Thread) -> None:
    """End a thread, and drop what it holds."""
    orders.put(None)
    if thread is not current_thread():
        thread.join(PATIENCE)


class RemoteDevice(Device):
    """A device of another process: ``send`` transmits orders to `Served.act` there, or raises `WorkerLost`."""

    def __init__(self, name: str, facts: Facts, send: Send) -> None:
        super().__init__(name, facts.description)
        self.kind: str = facts.name
        """Its name in that process."""
        self.is_gpu: bool = facts.is_gpu
        self._real = np.dtype(facts.real)
        self._orders: SimpleQueue[Queued] = SimpleQueue()
        self._written = 0
        self._count = 0
        self._items = lru_cache(maxsize=None)(lambda concept, name, shape: self._ask("items", concept, name, shape))
        self._lanes = lru_cache(maxsize=None)(lambda nz: self._ask("lanes", nz))
        thread = Thread(target=_work, args=(self._orders, send), name=name, daemon=True)
        thread.start()
        weakref.finalize(self, _end, self._orders, thread).atexit = False

    @property
    def real(self) -> np.dtype:
        return self._real

    def lanes_for(self, nz: int) -> int:
        return int(self._lanes(nz))

    def items(self, kernel: Kernel, shape: tuple[int, int, int]) -> int:
        return int(self._items(kernel.concept, kernel.name, tuple(shape)))

    def _tell(self, *order: Any) -> None:
        self._orders.put((order, None))

    def _later(self, *order: Any) -> Future[Any]:
        answer = Future[Any]()
        self._orders.put((order, answer))
        return answer

    def _ask(self, *order: Any) -> Any:
        return self._later(*order).result()

    def synchronize(self) -> None:
        self._ask("synchronize")

    def _allocate(self, shape: tuple[int, ...], dtype: np.dtype, lanes: int) -> _Handle:
        self._count += 1
        handle = _Handle(self._count, prod(shape), dtype)
        self._tell("empty", handle.number, tuple(shape), dtype.name, lanes)
        weakref.finalize(handle, self._orders.put, (("free", handle.number), None)).atexit = False
        return handle

    def _write(self, handle: _Handle, stored: np.ndarray, first: int = 0) -> None:
        self._tell("write", handle.number, stored.reshape(-1).copy(), first)
        self._written += stored.nbytes
        if self._written > STRIP:  # orders hold memory until they are sent
            self._written = 0
            self.synchronize()

    def _read(self, handle: _Handle, stored: np.ndarray, first: int = 0) -> None:
        stored.reshape(-1)[...] = self._ask("read", handle.number, stored.size, stored.dtype.name, first)

    def _asked(self, array: DeviceArray, *entries: int | None) -> Callable[[], np.ndarray]:
        if array.lanes or entries:
            return super()._asked(array, *entries)
        answer = self._later("read", array.handle.number, prod(array.shape), array.dtype.name, 0)
        return lambda: answer.result().reshape(array.shape)

    def _offer(self, handle: _Handle, taker: Device) -> Future[Any] | None:
        if not isinstance(taker, RemoteDevice):
            return None
        return self._later("read", handle.number, handle.count, handle.dtype.name, 0)

    def _take(self, handle: _Handle, giver: Device, offer: Future[Any]) -> None:
        self._tell("write", handle.number, offer, 0)

    def _launch(self, kernel: Kernel, bound: dict[str, Any], sizes: dict[str, int], lanes: int) -> None:
        given = {key: _Ref(value.number) if isinstance(value, _Handle) else value for key, value in bound.items()}
        self._tell("launch", kernel.concept, kernel.name, given, sizes, lanes)

    def _native(self, table: DeviceArray) -> Any:
        raise DeviceError(f"{self.name} keeps an array in another process, which no library can access; use .numpy()")

"""Devices of other processes, by a process that is this one: orders and answers travel as bytes."""

from __future__ import annotations

import gc
import pickle
import weakref
from concurrent.futures import Future
from queue import SimpleQueue
from typing import Any

import numpy as np
import pytest

import vamgpu as vam
from vamgpu.backend.remote import Order, Queued, RemoteDevice, Send, Served, _work
from vamgpu.backend.slabs import SlabDevice
from vamgpu.errors import DeviceError, OutOfMemory, WorkerLost
from vamgpu.operators.reductions import dot


def remote(served: Served) -> RemoteDevice:
    def send(orders: list[Order]) -> list[Any]:
        return pickle.loads(pickle.dumps(served.act(pickle.loads(pickle.dumps(orders)))))

    return RemoteDevice("there", served.facts(), send)


def light(device: Any) -> np.ndarray:
    A = vam.Projection(vam.Grid((12, 12, 9), 0.1), vam.Beam((18, 9), 0.1), vam.Turntable(16), device=device)
    part = np.zeros((12, 12, 9), np.float32)
    part[4:8, 4:8, 2:7] = 1.0
    return vam.optimize(A, part, "lbfgs", iterations=4, progress=False).sinogram.numpy()


def test_devices_of_other_processes_find_the_light_of_one() -> None:
    members = [remote(Served("numpy")) for _ in range(2)]
    assert {member.kind for member in members} == {"numpy"}
    found = light(SlabDevice("both", members))
    np.testing.assert_allclose(found, light("numpy"), rtol=1e-6, atol=1e-7)


def test_launches_and_borders_wait_for_no_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    """A product of two members sends orders alone; a sum asks both before it waits."""
    members = [remote(Served("numpy")) for _ in range(2)]
    both = SlabDevice("both", members)
    A = vam.Projection(vam.Grid((12, 12, 8), 0.1), vam.Beam((18, 8), 0.1, spread=0.1), vam.Turntable(16), device=both)
    light = both.upload(np.random.default_rng(0).random(A.range.shape))
    dose, again, asked, tell = A.T(light), both.empty(A.range.shape), [], RemoteDevice._tell
    A(dose, out=again)
    expected = dot(again, again)
    monkeypatch.setattr(RemoteDevice, "_ask", lambda *given: pytest.fail(f"asked for {given}"))
    monkeypatch.setattr(RemoteDevice, "_tell", lambda *given: asked.append(given[1]) or tell(*given))
    A.T(light, out=dose)
    A(dose, out=again)
    assert asked.count("write") >= 4  # slices of each member for the other, forward and back
    assert dot(again, again) == pytest.approx(expected, rel=1e-14)


def test_a_failure_is_told_to_whoever_asks_next() -> None:
    lost = WorkerLost("gone")

    def send(orders: list[Order]) -> list[Any]:
        raise lost

    device = RemoteDevice("there", Served("numpy").facts(), send)
    handle = device._allocate((4,), np.dtype(np.float64), 0)
    for _ in range(2):
        with pytest.raises(WorkerLost, match="gone"):
            device._read(handle, np.empty(4))


def test_what_nobody_holds_is_freed_there() -> None:
    gc.collect()
    ledger, served = vam.open_device("numpy").ledger, Served("numpy")
    before, device = ledger.allocated, remote(served)
    array = device.upload(np.ones((4, 4, 4), np.float32))
    assert array.numpy().sum() == 64 and len(served._handles) == 1 and ledger.allocated > before
    del array
    device.synchronize()
    assert not served._handles and ledger.allocated == before
    kept = device.upload(np.ones((4, 4, 4), np.float32))
    device.synchronize()
    assert ledger.allocated > before
    del kept, device, served  # as when a run is begun anew
    gc.collect()
    assert ledger.allocated == before


def test_a_process_that_fails_at_an_order_is_not_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    served = Served("numpy")
    with pytest.raises(DeviceError, match="numpy fails: KeyError: 7") as told:
        served.act([(True, "read", 7, 1, "float64", 0)])
    assert type(told.value) is DeviceError

    def full(*_: Any) -> Any:
        raise OutOfMemory("no room")

    device, values = remote(served), np.ones((4, 4, 4), np.float32)
    with monkeypatch.context() as patch, pytest.raises(OutOfMemory, match="no room"):
        patch.setattr(type(served._device), "_allocate", full)
        device.upload(values).numpy()
    assert device.upload(values).numpy().sum() == 64  # told once


def worked(send: Send, *items: Queued) -> None:
    """Send orders in one batch."""
    orders: SimpleQueue[Queued] = SimpleQueue()
    for item in (*items, None):
        orders.put(item)
    _work(orders, send)


def test_what_a_failing_batch_frees_is_freed() -> None:
    """Whether an order fails there, or the slices of a neighbor do not come; nothing else of the batch is done."""
    served, lost, told = Served("numpy"), Future[Any](), Future[Any]()
    lost.set_exception(WorkerLost("gone"))
    served.act([(False, "empty", number, (4,), "float64", 0) for number in (1, 2)])
    with pytest.raises(DeviceError, match="KeyError: 7"):
        served.act([(False, *each) for each in (("read", 7, 1, "<f8", 0), ("free", 1), ("empty", 3, (4,), "<f8", 0))])
    assert list(served._handles) == [2]
    worked(served.act, (("write", 2, lost, 0), None), (("free", 2), None), (("synchronize",), told))
    assert not served._handles
    with pytest.raises(WorkerLost, match="gone"):
        told.result(0)


def test_every_answer_reaches_who_asked() -> None:
    """Told orders may return something, and asked ones nothing; too few answers are a failure."""
    nothing, read, missing = (Future[Any]() for _ in range(3))
    worked(
        Served("numpy").act,
        (("synchronize",), None), (("empty", 1, (4,), "float64", 0), nothing), (("read", 1, 4, "float64", 0), read),
    )  # fmt: skip
    assert nothing.result(0) is None and read.result(0).shape == (4,)
    worked(lambda _: [], (("synchronize",), missing))
    with pytest.raises(ValueError, match="shorter"):
        missing.result(0)


@pytest.mark.parametrize("fails", [False, True])
def test_a_thread_that_waits_keeps_no_data(fails: bool) -> None:
    """Neither what it has sent nor what came back."""
    kept, alive = list[Any](), list[bool]()

    def data() -> np.ndarray:
        values = np.ones(4)
        kept.append(weakref.ref(values))
        return values

    def send(orders: list[Order]) -> list[Any]:
        if fails:
            raise WorkerLost("gone")
        return [data() for wanted, *_ in orders if wanted]

    class Orders:
        def empty(self) -> bool:
            return True

        def get(self) -> Queued:
            alive.extend(each() is not None for each in kept)
            asked = [None, Future[Any](), None][len(kept) % 3]
            return None if len(alive) > 3 else (("write", 1, data(), 0), asked)

    _work(Orders(), send)  # type: ignore[arg-type]
    assert len(alive) > 3 and not any(alive)

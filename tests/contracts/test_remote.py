"""Devices of other processes, by a process that is this one: orders and answers travel as bytes."""

from __future__ import annotations

import gc
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import vamgpu as vam
from vamgpu.backend.remote import Order, RemoteDevice, Served
from vamgpu.backend.slabs import SlabDevice
from vamgpu.errors import DeviceError, OutOfMemory


def remote(served: Served) -> RemoteDevice:
    def send(orders: list[Order]) -> Callable[[], list[Any]]:
        answers = pickle.dumps(served.act(pickle.loads(pickle.dumps(orders))))
        return lambda: pickle.loads(answers)

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
        served.act([("free", 7)])
    assert type(told.value) is DeviceError

    def full(*_: Any) -> Any:
        raise OutOfMemory("no room")

    monkeypatch.setattr(type(served._device), "_allocate", full)
    with pytest.raises(OutOfMemory, match="no room"):
        remote(served).upload(np.ones((4, 4, 4), np.float32)).numpy()

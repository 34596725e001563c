"""Contracts of every device: books of memory and transfers, foreign arrays without a copy, replays of launches."""

from __future__ import annotations

import gc
import threading
import time
import warnings
from contextlib import suppress
from typing import Any

import numpy as np
import pyopencl as cl
import pyopencl.array
import pytest
import warp as wp

import vamgpu
from vamgpu.backend.device import Device
from vamgpu.backend.opencl import OpenclDevice
from vamgpu.errors import BadInput, DeviceError
from vamgpu.kernels.reduce import fold
from vamgpu.kernels.update import linear


@pytest.mark.parametrize("shape", [(3, 5, 1), (4, 2, 67)])
def test_what_goes_up_comes_down(device: Device, shape: tuple[int, int, int]) -> None:
    values = np.random.default_rng(0).random(shape).astype(np.float32)
    assert np.array_equal(device.upload(values).numpy(), values)
    assert np.array_equal(device.upload(values, table=True).numpy(), values)


@pytest.mark.parametrize("shape", [(7, 5, 1), (7, 2, 67)])
def test_what_goes_up_in_parts_comes_down_in_strips(
    device: Device, shape: tuple[int, int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("vamgpu.backend.device.STRIP", 8 * shape[1] * shape[2])  # two entries of the first axis
    values = np.random.default_rng(0).random(shape).astype(np.float32)
    field = device.gather(shape, [values[:3], values[3:]])
    assert np.array_equal(field.numpy(), values) and np.array_equal(field.part(2, 5), values[2:5])


def test_compilers_that_talk_are_not_heard_from_any_thread(
    opencl_processor: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Filters belong to the process: a thread that ends its build must not open those of another."""
    both, build = threading.Barrier(2), cl.Program.build

    def talk(program: cl.Program, *given: Any, **named: Any) -> cl.Program:
        with suppress(threading.BrokenBarrierError):
            both.wait(0.5)
        if threading.current_thread() is threads[1]:
            threads[0].join(5.0)
        warnings.warn("Non-empty compiler output encountered", cl.CompilerWarning, stacklevel=1)
        return build(program, *given, **named)

    monkeypatch.setattr(cl.Program, "build", talk)
    device: Any = vamgpu.open_device(opencl_processor)
    threads = [threading.Thread(target=device.compile, args=(linear, 16)) for _ in range(2)]
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        for each in threads:
            each.start()
            time.sleep(0.05)
        for each in threads:
            each.join()
    assert not heard


def test_memory_is_booked_and_given_back(device: Device) -> None:
    gc.collect()
    before = device.ledger.allocated
    array = device.empty((8, 8, 64))
    assert device.ledger.allocated - before == array.nbytes >= 8 * 8 * 64 * device.real.itemsize
    del array
    gc.collect()
    assert device.ledger.allocated == before


def test_large_transfers_are_booked_and_small_ones_counted(device: Device) -> None:
    crossed, small = len(device.ledger.transfers), device.ledger.small
    big = device.upload(np.zeros((64, 64, 4)))
    device.upload(np.zeros(4, np.float32), table=True)
    assert device.ledger.transfers[crossed:] == [("upload", big.nbytes)]
    assert device.ledger.small == small + 1


def test_what_is_not_finite_stays_out(device: Device) -> None:
    with pytest.raises(BadInput, match="NaN or infinity"):
        device.upload(np.full((2, 2, 2), np.inf))
    with pytest.raises(BadInput, match="3 axes"):
        device.upload(np.zeros((2, 2)))


def foreign(device: Device, values: np.ndarray) -> object:
    """The values in an array of the device's own library."""
    if isinstance(device, OpenclDevice):
        return pyopencl.array.to_device(device.queue, values)
    if device.name == "numpy":
        return values
    return wp.array(values, dtype=wp.float32, device=device.name.partition(":")[2])


def back(theirs: Any) -> np.ndarray:
    """The values of such an array, by its own library's way to the host."""
    fetch = getattr(theirs, "get", None) or getattr(theirs, "numpy", None)
    return fetch() if fetch else theirs


def test_an_adopted_array_is_the_very_same(device: Device) -> None:
    theirs = foreign(device, np.arange(6, dtype=device.real))
    crossed = len(device.ledger.transfers), device.ledger.small
    ours = device.adopt(theirs)
    assert (len(device.ledger.transfers), device.ledger.small) == crossed
    few = device.empty((2,), device.real, table=True)
    device.launch(fold, parts=ours, kind=0, folded=few)
    assert few.numpy().tolist() == [0 + 2 + 4, 1 + 3 + 5]
    device.launch(fold, parts=few, kind=0, folded=device.adopt(theirs))  # writes where they look
    assert back(theirs)[:2].tolist() == [6, 9]


def test_what_cannot_be_adopted_is_refused(device: Device) -> None:
    with pytest.raises(DeviceError, match="adopt"):
        device.adopt([1.0, 2.0])


def test_a_replay_runs_what_was_captured(device: Device) -> None:
    x = device.upload(np.ones((4, 3, 5)))

    def double() -> None:
        device.launch(linear, a=2.0, x=x, b=0.0, y=x, floor=0.0, out=x)

    replay = device.capture(double)
    start = x.numpy()
    for _ in range(3):
        replay()
    assert np.array_equal(x.numpy(), 8.0 * start)


def test_a_device_is_known_by_what_people_call_it() -> None:
    names = vamgpu.devices()
    first = {part: next((n for n in names if f":{part}:" in f":{n}:"), None) for part in ("cuda", "opencl", "warp:cpu")}
    for called, name in (("OpenCL", first["opencl"]), ("NumPy", "numpy"), ("WARP:CPU", first["warp:cpu"])):
        if name is not None:
            assert vamgpu.open_device(called).name == name
    if first["cuda"] is not None:
        assert vamgpu.open_device("cuda") is vamgpu.open_device("cuda:0") is vamgpu.open_device("warp:cuda:0")
    gpus = [name for name in names if vamgpu.open_device(name).is_gpu]
    processors = [name for name in names if name not in gpus]
    assert vamgpu.open_device("CPU").name == processors[0]
    if gpus:
        assert vamgpu.open_device("gpu").name == gpus[0]
        return
    for called in ("gpu", "cuda:0"):
        with pytest.raises(DeviceError, match=f"no device '{called}'; available: {names[0]}"):
            vamgpu.open_device(called)


def test_a_limit_of_memory_goes_with_what_a_processor_is_called(opencl_processor: str) -> None:
    kind = opencl_processor.split(":")[1]
    assert vamgpu.open_device(f"{kind}@2GB") is vamgpu.open_device(f"opencl:{kind}:0@2GB")

"""Devices that share the slices of every field: the same numbers as one device alone, from every kernel."""

from __future__ import annotations

import errno
import os
from typing import Any

import kernel_examples as examples
import numpy as np
import pytest
from needs import missing

import vamgpu as vam
from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.backend.numpy import NumpyDevice
from vamgpu.backend.opencl import PLACES, OpenclDevice
from vamgpu.backend.opencl_platforms import context_of
from vamgpu.backend.slabs import SPARE, Copies, SlabDevice
from vamgpu.errors import DeviceError, OutOfMemory
from vamgpu.kernels.catalog import kernels
from vamgpu.kernels.reduce import fold, partial_sum
from vamgpu.kernels.signature import Field, Kernel, Table
from vamgpu.kernels.update import linear

THREE = "numpy+numpy+numpy"


@pytest.mark.parametrize("kernel", kernels(), ids=lambda kernel: kernel.name)
def test_kernels_agree_with_one_device(kernel: Kernel) -> None:
    for size in (7, 25):
        alone, shared = (examples.bind(vam.open_device(name), kernel, size) for name in ("numpy", THREE))
        alone.launch()
        shared.launch()
        assert shared.error(alone) < 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("kernel", kernels(), ids=lambda kernel: kernel.name)
@pytest.mark.parametrize("kind", ["opencl", "warp"])
def test_kernels_agree_on_devices(kind: str, kernel: Kernel) -> None:
    """A device that is three members of one, of each library."""
    name = next((name for name in vam.devices() if name.startswith(kind)), None)
    one = vam.open_device(name or missing(f"no {kind} device works here"))
    shared = SlabDevice("three", [one] * 3)
    size = 68 if kind == "opencl" else 25  # Warp takes one thread
    alone, three = (examples.bind(device, kernel, size) for device in (one, shared))
    alone.launch()
    three.launch()
    whole = any(a.dtype.kind in "iu" for a in three.arguments.values() if isinstance(a, DeviceArray))
    assert three.error(alone) <= (1e-3 if whole else 1e-5)


def lit(device: str | Device, rows: float = 1.0, **more: Any) -> tuple[Any, Any]:
    """A part, and its operator with a lens that blurs across slices, ``rows`` slices apart."""
    x, y, z = np.meshgrid(*(np.arange(n) - 0.5 * (n - 1) for n in (16, 16, 18)), indexing="ij")
    part = (np.hypot(x, y) < 5) & ((np.abs(x) > 1.5) | (np.abs(z) > 4))
    target = vam.Target.from_array(part.astype(float), pitch=0.25)
    beam = vam.Beam((18, 18), 0.25 * rows, spread=0.3)
    return target, vam.Projection(target.grid, beam, vam.Turntable(12), device=device, **more)


@pytest.mark.parametrize("vessel", [None, vam.Vial(4.0, 0.5, 1.49, 1.47, 1.0, 0.1)], ids=["straight", "vial"])
def test_light_and_dose_are_those_of_one_device(vessel: Any) -> None:
    doses = []
    for device in ("numpy", THREE):
        target, A = lit(device, vessel=vessel)
        light = np.random.default_rng(1).random(A.range.shape)
        doses.append((A.T(light), A(A.T(light))))
    for one, other in zip(*doses, strict=True):
        np.testing.assert_allclose(other, one, rtol=1e-12, atol=1e-12 * one.max())


@pytest.mark.parametrize("method", ["ramp", "osmo", "lbfgs", "bclp", "ramp at all corners"])
def test_methods_find_the_same_light(method: str) -> None:
    plans, (name, *corners) = [], method.split(" ", 1)
    tolerances = vam.Tolerances(spread=(0.15, 0.3)) if corners else None
    for device in ("numpy", THREE):
        target, A = lit(device)
        plans.append(
            vam.optimize(A, target, name, iterations=2 if corners else 3, tolerances=tolerances, progress=False)
        )
    one, other = plans
    np.testing.assert_allclose(other.sinogram.numpy(), one.sinogram.numpy(), rtol=1e-6, atol=1e-7)
    assert other.window == pytest.approx(one.window, abs=1e-8)


def happened(device: Device, method: str, rows: float, monkeypatch: pytest.MonkeyPatch) -> tuple[int, int, int]:
    """In two iterations: times that the host waits for an answer, bytes it writes, and bytes of fields that cross."""
    target, A = lit(device, rows)
    vam.optimize(A, target, method, iterations=2, progress=False)  # what is built once is built
    waits: list[bool] = []  # whether something was launched since the last answer
    written, exchanged = [], []
    launched, read, write, take = (getattr(NumpyDevice, n) for n in ("_launch", "_read", "_write", "_take"))
    with monkeypatch.context() as patch:
        patch.setattr(NumpyDevice, "_launch", lambda *given: waits.append(True) or launched(*given))
        patch.setattr(NumpyDevice, "_read", lambda *given: waits.append(False) or read(*given))
        patch.setattr(NumpyDevice, "_write", lambda *given: written.append(given[2].nbytes) or write(*given))
        patch.setattr(
            NumpyDevice, "_take", lambda *given: exchanged.append(given[3].nbytes * (given[3].ndim > 2)) or take(*given)
        )
        found = []
        for iterations in (4, 6):
            for each in (waits, written, exchanged):
                each.clear()
            vam.optimize(A, target, method, iterations=iterations, progress=False)
            answers = sum(before and not now for before, now in zip(waits, waits[1:], strict=False))
            found.append((answers, sum(written), sum(exchanged)))
    return tuple(later - earlier for earlier, later in zip(*found, strict=True))  # type: ignore[return-value]


@pytest.mark.parametrize(("method", "products"), [("lbfgs", 2), ("osmo", 4)])
def test_members_exchange_borders_and_the_host_waits_as_for_one(
    method: str, products: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An iteration moves the slices over which a lens spreads, and waits no more often than one device does."""
    alone = happened(NumpyDevice(), method, 1.0, monkeypatch)
    for count in (2, 3):
        shared = happened(SlabDevice("several", [NumpyDevice() for _ in range(count)]), method, 1.0, monkeypatch)
        assert shared[:2] == alone[:2]
        borders, reach = 2 * (count - 1), 5  # four standard deviations of the lens
        assert 0 < shared[2] <= 2 * products * borders * reach * 12 * 18 * 8


@pytest.mark.parametrize("rows", [1.0, 1.6])
def test_a_step_moves_no_field_to_one_member(rows: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """In the loop members exchange sums and the slices at their borders, never a field."""
    three = SlabDevice("three", [NumpyDevice(), NumpyDevice(), NumpyDevice()])
    target, A = lit(three, rows)
    vam.optimize(A, target, "lbfgs", iterations=2, progress=False)  # what is built once is built
    met: set[str] = set()
    brought: list[int] = []
    run, take = SlabDevice._run_whole, NumpyDevice._take

    def seen(self: SlabDevice, kernel: Kernel, bound: dict[str, Any]) -> None:
        met.update(kernel.name for spec in kernel.arguments.values() if isinstance(spec, Field))
        run(self, kernel, bound)

    monkeypatch.setattr(SlabDevice, "_run_whole", seen)
    monkeypatch.setattr(NumpyDevice, "_take", lambda *given: brought.extend(given[3].shape[2:]) or take(*given))
    vam.optimize(A, target, "lbfgs", iterations=4, progress=False)
    assert not met
    assert brought and max(brought) <= 5  # four standard deviations of the lens


def test_partial_results_are_combined_where_they_are(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every member folds its own, and few numbers cross."""
    device = SlabDevice("three", [NumpyDevice(), NumpyDevice(), NumpyDevice()])
    values = np.random.default_rng(0).random((6, 5, 12))
    field, parts = device.upload(values), device.empty((device.items(partial_sum, values.shape),), table=True)
    device.launch(partial_sum, a=field, parts=parts)
    met, launch = [], NumpyDevice._launch
    monkeypatch.setattr(NumpyDevice, "_launch", lambda *given: met.append(given[1].name) or launch(*given))
    for kind, wanted in enumerate((np.sum, np.min, np.max)):
        folded = device.empty((1,), table=True)
        device.launch(fold, parts=parts, kind=kind, folded=folded)
        assert met == ["fold"] * 3 * (kind + 1)
        assert folded.numpy()[0] == pytest.approx(wanted([values[:, :, z : z + 4].sum() for z in (0, 4, 8)]), rel=1e-14)


def test_a_table_is_read_once_for_all_members(monkeypatch: pytest.MonkeyPatch) -> None:
    three, met, read = vam.open_device(THREE), [], Copies.read
    assert isinstance(three, SlabDevice)
    monkeypatch.setattr(Copies, "read", lambda table: met.append(table) or read(table))
    table, cuts = three.upload(np.arange(10), np.int32, table=True), three.cuts(10)
    spans, parts = table.handle.band(three.members, cuts, 2, 10)
    assert len(met) == 1 and spans == [(0, 5), (4, 9), (8, 10)]
    assert [part.numpy().tolist() for part in parts] == [[0, 1, 2, 3], [0, 1, 2, 3], [0, 1]]
    parts = table.handle.shared(three.members, 0, cuts, Table("int32", ("z",)))
    assert len(met) == 2 and [part.numpy().tolist() for part in parts] == [[0, 1, 2, 3], [4, 5, 6, 7], [8, 9]]


def test_few_temporary_fields_are_kept_and_none_without_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    members = [NumpyDevice(), NumpyDevice()]
    two, ones = SlabDevice("two", members), np.ones((4, 4, 8))
    field = two.upload(ones)

    def keep() -> None:
        for size in range(1, 20):
            two._keep(*(two._scratch(member, (size, 4, 4)) for member in members))

    keep()
    assert set(two._spare) == {(member, (size, 4, 4)) for member in members for size in range(20 - SPARE, 20)}
    last = two._spare[members[0], (19, 4, 4)][0]
    assert two._scratch(members[0], (19, 4, 4)) is last

    def full(*_: Any) -> Any:
        raise OutOfMemory("no room")

    for name, act in {
        "_allocate": lambda: two.empty((4, 4, 8)),
        "_write": lambda: two.upload(ones),
        "_read": field.numpy,
        "_launch": lambda: two.launch(linear, a=1.0, x=field, b=0.0, y=field, floor=0.0, out=field),
        "synchronize": two.synchronize,
    }.items():
        keep()
        with monkeypatch.context() as patch, pytest.raises(OutOfMemory, match="no room"):
            patch.setattr(NumpyDevice, name, full)
            act()
        assert not two._spare, name


def test_names_of_several_devices() -> None:
    three = vam.open_device(THREE)
    assert isinstance(three, SlabDevice) and [member.name for member in three.members] == ["numpy"] * 3
    assert three.cuts(10) == [(0, 4), (4, 8), (8, 10)] and three.cuts(3) == [(0, 3), (3, 3), (3, 3)]
    assert three.cuts(1000) == [(0, 352), (352, 704), (704, 1000)]
    with pytest.raises(DeviceError, match="one kind"):
        vam.open_device("numpy+warp:cpu")
    with pytest.raises(DeviceError, match="no device 'nothing:0'"):
        vam.open_device("numpy+nothing:0")
    with pytest.raises(DeviceError, match="no device .*nothing:"):
        vam.open_device("nothing:*")
    with pytest.raises(DeviceError, match="several devices"):
        three.upload(np.ones((2, 3, 4))).native()


def _full(*_: Any) -> None:
    raise OSError(errno.ENOSPC, "No space left on device")


def test_fields_beyond_the_memory_lie_in_files(
    opencl_name: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Any
) -> None:
    """The light is the same bit by bit, wherever its fields were kept; GPUs keep none in files."""
    if vam.open_device(opencl_name).is_gpu:
        with pytest.raises(DeviceError, match="processor"):
            vam.open_device(opencl_name + "@100kB")
        return
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    filed: list[int] = []
    in_file = OpenclDevice._in_file
    monkeypatch.setattr(OpenclDevice, "_in_file", lambda self, nbytes: filed.append(nbytes) or in_file(self, nbytes))
    plans = []
    for memory in ("", "@100kB"):
        target, A = lit(opencl_name + memory)
        plans.append(vam.optimize(A, target, iterations=6, progress=False).sinogram.numpy())
        assert bool(filed) == bool(memory)
    assert (plans[0] == plans[1]).all()
    monkeypatch.setenv("TMPDIR", str(tmp_path / "nowhere"))
    with pytest.raises(OutOfMemory, match="set TMPDIR"):
        vam.open_device(f"{opencl_name}@1B").empty((4, 4, 4))
    if hasattr(os, "posix_fallocate"):
        monkeypatch.setenv("TMPDIR", str(tmp_path))
        monkeypatch.setattr(os, "posix_fallocate", _full)
        with pytest.raises(OutOfMemory, match="No space left.*set TMPDIR"):
            vam.open_device(f"{opencl_name}@1B").empty((4, 4, 4))
    with pytest.raises(DeviceError, match="expected an OpenCL processor"):
        vam.open_device("numpy@1GB")
    with pytest.raises(DeviceError, match="a size of memory"):
        vam.open_device(f"{opencl_name}@much")


@pytest.mark.parametrize("kind", ["numpy", "opencl", "warp:cpu"])
def test_borders_pass_from_member_to_member_where_one_library_knows_both(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two devices with queues of their own: nothing is read to the host, and no border comes before it was computed."""
    if kind == "opencl":
        from vamgpu.backend.opencl_platforms import context_of

        name = next(name for name in vam.devices() if name.startswith("opencl"))
        members: list[Device] = [OpenclDevice(name, context_of(name)) for _ in range(2)]
    elif kind == "warp:cpu":
        from vamgpu.backend.warp import WarpDevice

        members = [WarpDevice(kind, "cpu") for _ in range(2)]
    else:
        members = [NumpyDevice() for _ in range(2)]
    two = SlabDevice("two", members)
    target, A = lit(two)
    _, alone = lit(members[0])
    light = np.random.default_rng(1).random(A.range.shape).astype(np.float32)
    here, there = two.upload(light), members[0].upload(light)
    dose, other = A.T(here), alone.T(there)
    brought = list[int]()
    take = type(members[0])._take
    monkeypatch.setattr(type(members[0]), "_take", lambda *given: brought.append(1) or take(*given))
    for _ in range(8):
        for operator, sent, got in ((A, here, dose), (alone, there, other)):
            operator.T(sent, out=got)
            operator(got, out=sent)
    loaded = type(members[0])._load
    monkeypatch.setattr(type(members[0]), "_load", lambda *given: pytest.fail("read to the host"))
    A.T(here, out=dose)
    monkeypatch.setattr(type(members[0]), "_load", loaded)
    alone.T(there, out=other)
    assert len(brought) >= 16
    expected = other.numpy()
    np.testing.assert_allclose(dose.numpy(), expected, rtol=1e-4, atol=1e-5 * expected.max())


def test_devices_of_other_libraries_pass_borders_through_the_host(opencl_name: str) -> None:
    from vamgpu.backend.opencl_platforms import all_devices

    gpu = vam.open_device(opencl_name).is_gpu
    other = next((n for n in all_devices() if n != opencl_name and vam.open_device(n).is_gpu == gpu), None)
    if other is None:
        pytest.skip("one OpenCL platform of this kind is here")
    target, A = lit(f"{opencl_name}+{other}")
    _, alone = lit(opencl_name)
    light = np.random.default_rng(1).random(A.range.shape).astype(np.float32)
    expected = alone.T(light)
    np.testing.assert_allclose(A.T(light), expected, rtol=1e-4, atol=1e-5 * expected.max())


def test_scenarios_stay_where_they_are(monkeypatch: pytest.MonkeyPatch) -> None:
    """A run at all corners puts the slices of each among those of all, on the members that keep them."""
    met: list[str] = []
    run = SlabDevice._run_whole
    monkeypatch.setattr(
        SlabDevice, "_run_whole", lambda self, kernel, bound: met.append(kernel.name) or run(self, kernel, bound)
    )
    target, A = lit(THREE)
    vam.optimize(A, target, iterations=1, tolerances=vam.Tolerances(spread=(0.15, 0.3)), progress=False)
    assert not {"put_slices", "resample"} & set(met)


def test_slices_for_a_neighbor_pass_through_few_pinned_pages(opencl_name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Copies that follow each other, of several sizes, arrive in order, and their number bounds the memory."""
    context = context_of(opencl_name)
    source, sink = OpenclDevice(opencl_name, context), OpenclDevice(opencl_name, context)
    monkeypatch.setattr(source, "is_gpu", True)  # as between GPUs
    rng, arrived = np.random.default_rng(0), []
    for count in (1000, 50_000, 1000, 200_000, 50_000) * 4:
        values = rng.random(count).astype(np.float32)
        there, here = source._allocate((count,), values.dtype, 0), sink.empty(values.shape, np.float32, table=True)
        source._write(there, values)
        sink._take(here.handle, source, source._offer(there, sink))
        arrived.append((values, here))
    assert all(np.array_equal(here.numpy(), values) for values, here in arrived)
    assert len(source._places) == PLACES

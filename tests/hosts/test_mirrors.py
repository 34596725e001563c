"""The mirror array's driver against an emulated library; an hour of it with lens and controller."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from vamgpu.errors import (
    BadInput,
    DeviceBusy,
    DeviceError,
    DeviceLost,
    DeviceNotFound,
    DeviceRefused,
    OutOfMemory,
    WrongDevice,
)
from vamgpu.hosts.drivers import alp
from vamgpu.hosts.drivers.controller import Controller
from vamgpu.hosts.drivers.controller_protocol import ControllerRow
from vamgpu.hosts.drivers.dmd import Dmd, SlotTiming
from vamgpu.hosts.drivers.lens import LensDriver
from vamgpu.hosts.drivers.memory import MirrorMemory
from vamgpu.hosts.drivers.wire import Wire
from vamgpu.hosts.emulators.alp import EmulatedAlp
from vamgpu.hosts.emulators.array import ArrayModel, DisplayedFrame
from vamgpu.hosts.emulators.clock import VirtualClock
from vamgpu.hosts.emulators.controller import EmulatedController
from vamgpu.hosts.emulators.lens import EmulatedLens
from vamgpu.hosts.emulators.line import Cable, Faults, LineDevice, VirtualPort

MILLI, SECOND = 1_000_000, 1_000_000_000


def _wire(machine: LineDevice, clock: VirtualClock, faults: Faults | None = None, timeout_s: float = 0.1) -> Wire:
    return Wire(VirtualPort(machine, clock, timeout_s, faults=faults), "the machine")


def _dmd(**options: object) -> tuple[VirtualClock, EmulatedAlp, Dmd]:
    clock = VirtualClock()
    fake = EmulatedAlp(clock, ArrayModel(height=6, width=16, **options))  # type: ignore[arg-type]
    return clock, fake, Dmd(fake.library)


def _packed(levels: np.ndarray) -> np.ndarray:
    return np.stack([np.packbits(levels >> (7 - bit) & 1, axis=-1) for bit in range(8)], axis=1)


def test_two_sequences_stream_more_than_fits_one_a_trigger() -> None:
    clock, fake, dmd = _dmd(planes=64)
    levels = np.random.default_rng(0).integers(0, 256, (37, 6, 16), dtype=np.uint8)
    shown: list[DisplayedFrame] = []
    fake.on_shown = shown.append
    dmd.slave()
    with pytest.raises(OutOfMemory, match="296 planes, and 64 are free"):
        dmd.sequence(37, 8)
    stream = MirrorMemory(dmd, 4, 8, SlotTiming(5000, 5000))
    assert dmd.free_planes() == 0 and stream._all[0].sequence.limits().on_us == 5000
    put = 0
    for trigger in range(37):
        while put < 37 and stream.room():
            stream.put(_packed(levels[put : put + 4]))
            put += len(levels[put : put + 4])
        if trigger == 0:
            with pytest.raises(DeviceError, match="room"):
                stream.put(_packed(levels[:4]))
        fake.trigger(clock.now())
        assert stream.shown() == trigger + 1
        clock.sleep(10 * MILLI)
    assert fake.counts == {"shown": 37, "missed": 0, "empty": 0, "uploaded": 37, "upload_bytes": 37 * 8 * 12}
    for each, wanted in zip(shown, levels, strict=True):
        bits = [each.mirrors(plane, 16) << (7 - plane) for plane in range(8)]
        assert np.array_equal(sum(bits), wanted)
    assert stream.shown() == 37
    stream.close()
    assert dmd.free_planes() == 64


def test_what_does_not_fit_the_mirrors_is_refused() -> None:
    _, _, dmd = _dmd()
    sequence = dmd.sequence(2, 8)
    for wrong in (np.zeros((1, 8, 6, 3), np.uint8), np.zeros((1, 8, 6, 2)), np.zeros((1, 8, 6, 4), np.uint8)[..., ::2]):
        with pytest.raises(BadInput, match="packed frames"):
            sequence.put(wrong)
    with pytest.raises(BadInput, match="do not fit"):
        sequence.put(np.zeros((2, 8, 6, 2), np.uint8), 1)
    with pytest.raises(DeviceRefused, match="least_picture_us=3760"):
        sequence.retime(SlotTiming(3000, 3000))


def test_the_mirror_arrays_failures_are_named() -> None:
    clock, fake, dmd = _dmd()
    with pytest.raises(DeviceBusy):
        Dmd(fake.library)
    with pytest.raises(DeviceNotFound):
        Dmd(EmulatedAlp(clock).library, serial=5)
    with pytest.raises(WrongDevice, match="6 x 16"):
        Dmd(EmulatedAlp(clock, ArrayModel(height=6, width=16)).library, size=(1080, 1920))
    with pytest.raises(DeviceNotFound, match="AlpDevAlloc"):
        Dmd(SimpleNamespace())
    fake.removed = True
    with pytest.raises(DeviceLost, match="unplugged"):
        dmd.progress()
    dmd.close()


def test_a_closed_mirror_array_floats_and_is_free_for_another() -> None:
    _, fake, dmd = _dmd()
    with dmd:
        dmd.slave()
        MirrorMemory(dmd, 1, 1).put(np.zeros((1, 1, 6, 2), np.uint8))
    assert fake.floating and not fake.allocated
    dmd.close()


def test_the_libraries_numbers_have_32_bits() -> None:
    import ctypes

    assert ctypes.sizeof(alp.Progress) == 36
    kinds = {kind for types in alp.SIGNATURES.values() for kind in types}
    assert ctypes.c_long not in kinds or ctypes.sizeof(ctypes.c_long) == 4


def _hour() -> list[tuple[object, ...]]:
    """An hour of one frame a second on every machine, and all that was seen of it."""
    clock, fake, dmd = _dmd()
    lens, machine = EmulatedLens(), EmulatedController()
    driver = Controller(_wire(machine, clock))
    focus = LensDriver(_wire(lens, clock))
    focus.focal_power_mode()
    cable = Cable(lens, 38400)
    clock.attach(cable)
    machine.on_trigger, machine.on_lens = fake.trigger, cable.send
    seen: list[tuple[object, ...]] = []
    fake.on_shown = lambda shown: seen.append((shown.number, shown.starts, shown.ends, lens.power(shown.starts[0])))
    dmd.slave()
    stream = MirrorMemory(dmd, 60, 8, SlotTiming(500_000, 500_000))
    frames = np.zeros((60, 8, 6, 2), np.uint8)
    driver.lease(1000)
    driver.arm()
    driver.end(3600)
    row = 0
    while stream.shown() < 3600:
        while stream.room() and stream.queued < 3600:
            stream.put(frames)
        while row < 3600 and row - stream.shown() < 200:
            driver.row(ControllerRow(row, 1_000_000 * row + 10_000, 1000 + row % 3 * 100, 7600, 500_000))
            row += 1
        if not seen and not machine.running:
            driver.go(5)
        driver.lease(1000)
        clock.sleep(900 * MILLI)
    driver.lease(1000)
    clock.sleep(900 * MILLI)
    assert driver.status().state == "done" and driver.status().late == 0 and fake.counts["missed"] == 0
    assert machine.intervals[-1][1] - machine.intervals[-1][0] == 500 * MILLI
    return seen


@pytest.mark.slow
def test_an_hour_passes_in_seconds_and_twice_the_same() -> None:
    first = _hour()
    assert len(first) == 3600 and first == _hour()
    starts = [entry[1][0] for entry in first]  # type: ignore[index]
    assert set(np.diff(starts)) == {SECOND}, "no drift"
    assert [round(entry[3], 2) for entry in first[:3]] == [0.0, 0.5, 1.0]  # type: ignore[arg-type]

"""The emulated mirror array, through its C functions."""

from __future__ import annotations

import ctypes

import numpy as np

from vamgpu.hosts.emulators.alp import EmulatedAlp
from vamgpu.hosts.emulators.array import ArrayModel, DisplayedFrame
from vamgpu.hosts.emulators.clock import VirtualClock

MILLI, SECOND = 1_000_000, 1_000_000_000


def _array(clock: VirtualClock, **options: object) -> tuple[EmulatedAlp, ctypes.c_uint32, list[DisplayedFrame]]:
    fake = EmulatedAlp(clock, ArrayModel(height=4, width=16, **options))  # type: ignore[arg-type]
    device = ctypes.c_uint32()
    assert fake.library.AlpDevAlloc(0, 0, ctypes.byref(device)) == 0
    shown: list[DisplayedFrame] = []
    fake.on_shown = shown.append
    return fake, device, shown


def _sequence(fake: EmulatedAlp, device: ctypes.c_uint32, planes: np.ndarray) -> int:
    sequence = ctypes.c_uint32()
    alp = fake.library
    assert alp.AlpSeqAlloc(device, planes.shape[1], len(planes), ctypes.byref(sequence)) == 0
    assert alp.AlpSeqPut(device, sequence, 0, len(planes), planes.ctypes.data) == 1005, (
        "bytes are not what drivers send"
    )
    assert alp.AlpSeqControl(device, sequence, 2110, 2) == 0
    assert alp.AlpSeqPut(device, sequence, 0, len(planes), planes.ctypes.data) == 0
    return sequence.value


def test_mirrors_light_each_plane_for_its_share() -> None:
    levels = np.random.default_rng(1).integers(0, 256, (3, 4, 16), dtype=np.uint8)
    planes = np.stack([np.packbits(levels >> (7 - b) & 1, axis=-1) for b in range(8)], axis=1)
    clock = VirtualClock()
    fake, device, shown = _array(clock)
    sequence = _sequence(fake, device, np.ascontiguousarray(planes))
    assert fake.library.AlpSeqTiming(device, sequence, 10_000, 12_000, 0, 0, 0) == 0
    assert fake.library.AlpProjStart(device, sequence) == 0
    clock.sleep(SECOND)
    assert [each.starts[0] for each in shown] == [0, 12 * MILLI, 24 * MILLI]
    for each, wanted in zip(shown, levels, strict=True):
        lit = [end - start for start, end in zip(each.starts, each.ends, strict=True)]
        light = sum(each.mirrors(plane, 16).astype(float) * lit[plane] for plane in range(8))
        assert np.abs(light / (10 * MILLI) - wanted / 255).max() < 1e-6


def test_memory_limits_and_states_are_the_librarys() -> None:
    fake, device, _ = _array(VirtualClock(), planes=20)
    alp, sequence, number = fake.library, ctypes.c_uint32(), ctypes.c_int32()
    assert alp.AlpSeqAlloc(device, 8, 3, ctypes.byref(sequence)) == 1007
    assert alp.AlpSeqAlloc(device, 8, 2, ctypes.byref(sequence)) == 0
    assert alp.AlpDevInquire(device, 2003, ctypes.byref(number)) == 0 and number.value == 4
    assert alp.AlpSeqTiming(device, sequence, 0, 3000, 0, 0, 0) == 1005, "eight bits take longer"
    assert alp.AlpProjStart(device, sequence) == 0
    assert alp.AlpSeqFree(device, sequence) == 1008
    assert alp.AlpDevFree(device) == 1002
    assert alp.AlpProjHalt(device) == 0
    assert alp.AlpSeqFree(device, sequence) == 0
    fake.removed = True
    assert alp.AlpDevInquire(device, 2003, ctypes.byref(number)) == 1012


def test_triggers_that_come_too_soon_are_missed_and_a_halt_cuts_the_frame() -> None:
    clock = VirtualClock()
    fake, device, shown = _array(clock)
    alp = fake.library
    assert alp.AlpProjControl(device, 2300, 2302) == 0 and alp.AlpDevControl(device, 2014, 1) == 0
    sequence = _sequence(fake, device, np.full((4, 8, 4, 2), 255, np.uint8))
    assert alp.AlpSeqTiming(device, sequence, 5000, 5000, 0, 0, 1000) == 0
    assert alp.AlpProjStart(device, sequence) == 0
    for at in (0, 3, 10, 20):
        clock.sleep_until(at * MILLI)
        fake.trigger(at * MILLI)
    clock.sleep_until(22 * MILLI)
    assert alp.AlpProjHalt(device) == 0
    assert fake.counts["missed"] == 1 and fake.counts["shown"] == 3
    assert [(each.starts[0], each.ends[-1]) for each in shown] == [
        (MILLI, 6 * MILLI),
        (11 * MILLI, 16 * MILLI),
        (21 * MILLI, 22 * MILLI),
    ]


def test_slave_mode_times_out_unless_told_not_to() -> None:
    clock = VirtualClock()
    fake, device, _ = _array(clock)
    alp, state = fake.library, ctypes.c_int32()
    assert alp.AlpProjControl(device, 2300, 2302) == 0
    sequence = _sequence(fake, device, np.zeros((1, 1, 4, 2), np.uint8))
    assert alp.AlpProjStart(device, sequence) == 0
    clock.sleep(2 * SECOND)
    assert alp.AlpProjInquire(device, 2400, ctypes.byref(state)) == 0 and state.value == 1201


def test_progress_is_36_bytes() -> None:
    fake, device, _ = _array(VirtualClock())
    words = (ctypes.c_uint32 * 10)(*[7] * 10)
    assert fake.library.AlpProjInquireEx(device, 2318, words) == 0
    assert words[8] == 1 and words[9] == 7, "nothing behind the structure is touched"

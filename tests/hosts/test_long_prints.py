"""Prints that last: turns of a vial are uploaded once, the mirrors' queue is asked, ten metres of web end."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace
from math import pi
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vamgpu.errors import DeviceRefused
from vamgpu.hosts.drivers.controller import Encoder
from vamgpu.hosts.drivers.dmd import Dmd, SlotTiming
from vamgpu.hosts.drivers.memory import MirrorMemory
from vamgpu.hosts.emulators.alp import EmulatedAlp
from vamgpu.hosts.emulators.array import ArrayModel
from vamgpu.hosts.emulators.clock import PacedClock, VirtualClock
from vamgpu.hosts.emulators.rigs import EmulatedMirrorRig
from vamgpu.hosts.player.controller_mirrors import PREROLL, TriggeredPlayer
from vamgpu.hosts.player.run import Print
from vamgpu.hosts.records.account import account
from vamgpu.hosts.records.record import FRAME_RECORD, FrameRecord, RunFolder, read_run
from vamgpu.hosts.records.state import PrintState
from vamgpu.hosts.rigs.preflight import Judged, Residence, judged, round_again
from vamgpu.hosts.safety.interlock import InterlockOpen
from vamgpu.hosts.schedules.limits import MirrorTiming
from vamgpu.hosts.schedules.mirrors import turned, web
from vamgpu.hosts.schedules.schedule import Schedule

MODEL = ArrayModel(height=2, width=16)
MIRRORS = MirrorTiming(pixels=(16, 2), row_bytes=2, dark=2e-3)
STEPS = 200
QUEUE = 256


class Numbered:
    """Frames whose level is their number + 1. made: how many."""

    bits = 8

    def __init__(self) -> None:
        self.made = 0

    def planes(self, numbers: np.ndarray) -> np.ndarray:
        self.made += len(numbers)
        bits = np.unpackbits((numbers + 1).astype(np.uint8)[:, None], axis=1)
        return np.broadcast_to(255 * bits[:, :, None, None], (len(numbers), 8, 2, 2)).astype(np.uint8)

    def frame(self, number: int) -> np.ndarray:
        return np.full((2, 16), number + 1, np.uint8)


def rig(schedule: Schedule, clock: VirtualClock, model: ArrayModel = MODEL) -> tuple[EmulatedMirrorRig, Any, Judged]:
    emulated = EmulatedMirrorRig(STEPS, model, clock=clock)
    machines = emulated.machines(STEPS / float(schedule.advance))
    return emulated, machines, judged(schedule, machines.mirrors, machines.clock, seconds=0.02)


def made(schedule: Schedule, path: Path, model: ArrayModel = MODEL) -> tuple[EmulatedMirrorRig, Numbered, Print]:
    emulated, machines, found = rig(schedule, VirtualClock(), model)
    frames = Numbered()
    player = TriggeredPlayer(
        schedule, machines, [frames], depth=found.depth, sequences=found.sequences, turn=found.turn
    )
    return emulated, frames, Print(player, RunFolder.begin(path, {}, ""))


def right(emulated: EmulatedMirrorRig, schedule: Schedule, turns: int) -> None:
    """Every pose got the light of its own frame, in every turn."""
    count = schedule.frames
    lit = emulated.recorder.seconds(0, count, turn=count)[0, :, 0, 0]
    wanted = turns * 1e-9 * schedule.on[0] * (np.arange(count) + 1) / 255
    assert np.abs(lit / wanted - 1).max() < 5e-3


@pytest.mark.parametrize("turns", [30, 3000])
def test_a_print_that_fits_the_mirrors_starts_however_long_it_lasts(turns: int) -> None:
    schedule = turned(120, speed=24, engines=MIRRORS, turns=turns)
    emulated, machines, found = rig(schedule, PacedClock())
    assert found.turn == 120 and found.found[0].residence is Residence.RESIDENT and found.sequences <= QUEUE
    player = TriggeredPlayer(
        schedule, machines, [Numbered()], depth=found.depth, sequences=found.sequences, turn=found.turn
    )
    measured = emulated.alps[0].counts["uploaded"]
    player._fill(0, lambda: None)
    assert emulated.alps[0].counts["uploaded"] - measured == 120 + PREROLL
    player.halt()


def test_streamed_frames_leave_the_queue_its_places() -> None:
    """A web whose frames all fit is more sequences than the queue has places: the rest waits for its turn."""
    dmd = Dmd(EmulatedAlp(VirtualClock(), replace(MODEL, planes=10_000)).library)
    dmd.slave()
    memory = MirrorMemory(dmd, 2, 8, SlotTiming(5000, 5000), sequences=300)
    put = 0
    while memory.room():
        memory.put(np.zeros((2, 8, 2, 2), np.uint8))
        put += 1
    assert put == QUEUE and dmd.queue_places() == 0
    with pytest.raises(DeviceRefused, match="queue is full.*0 places are free"):
        memory._free[0].sequence.start(2)


def test_turns_are_uploaded_and_made_once(tmp_path: Path) -> None:
    schedule = turned(40, speed=40, engines=MIRRORS, turns=6)
    emulated, frames, job = made(schedule, tmp_path / "run")
    assert job.run() is PrintState.COMPLETE
    assert round_again(schedule) == 40 and frames.made <= 40 + PREROLL + 40
    assert emulated.alps[0].counts["uploaded"] <= 40 + PREROLL
    assert emulated.alps[0].counts["shown"] == 240 + PREROLL and emulated.alps[0].counts["missed"] == 0
    right(emulated, schedule, 6)


def test_a_print_paused_in_mid_turn_goes_on_from_there(tmp_path: Path) -> None:
    schedule = turned(40, speed=40, engines=MIRRORS, turns=5)
    emulated, _, job = made(schedule, tmp_path / "run")
    with job.guard:
        job.begin(0)
        while job.next < 57:
            job.player.wait()
            assert job.step()
        job.pause()
        while job.step():
            job.player.wait()
    assert job.run() is PrintState.COMPLETE
    job.folder.close()
    shown = read_run(tmp_path / "run").shown
    assert shown["slot"].tolist() == list(range(200)) and not shown["dark"].any()
    right(emulated, schedule, 5)


def test_what_was_late_in_the_first_turn_is_shown_in_an_added_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Frames 20 to 39 come too late once; later turns have them whole, and are uploaded once."""
    from vamgpu.hosts.frames.upload import UploadQueue

    schedule = turned(40, speed=40, engines=MIRRORS, turns=4)
    emulated, _, job = made(schedule, tmp_path / "run")
    make = UploadQueue.make

    def late(self: UploadQueue, timeout: float = 0.0) -> bool:
        held = self.made >= PREROLL + 20 and len(self.late) < 3 and len(self) == 160 + PREROLL
        return False if held else make(self, timeout)

    monkeypatch.setattr(UploadQueue, "make", late)
    monkeypatch.setattr(UploadQueue, "primed", property(lambda self: self.made >= PREROLL + 20))
    assert job.run() is PrintState.COMPLETE
    job.folder.close()
    shown = read_run(tmp_path / "run").shown
    black = shown["slot"][shown["dark"] > 0]
    assert len(black) == 3 and set(black) <= set(range(20, 40))
    assert len(shown) == 200, "one turn was added"
    right(emulated, schedule, 4)
    assert emulated.alps[0].counts["uploaded"] <= 2 * 40 + 3 + PREROLL + 40, "not turn by turn"


@pytest.mark.slow
def test_three_hundred_turns_start_and_end(tmp_path: Path) -> None:
    schedule = turned(12, speed=270, engines=MIRRORS, turns=300)
    emulated, frames, job = made(schedule, tmp_path / "run")
    assert job.run() is PrintState.COMPLETE
    assert emulated.alps[0].counts["uploaded"] < 200 and frames.made < 200
    assert len(read_run(tmp_path / "run").shown) == 300 * 12
    right(emulated, schedule, 300)


@pytest.mark.parametrize("feedback", [True, False], ids=["encoder", "none"])
def test_a_stalled_motor_ends_the_print_where_an_encoder_sees_it(tmp_path: Path, feedback: bool) -> None:
    schedule = turned(40, speed=40, engines=MIRRORS, turns=2)
    emulated, _, job = made(schedule, tmp_path / "run")
    emulated.controller.senses.edges = (1, 10)
    if feedback:
        step = float(schedule.advance) / STEPS
        job.player.machines.controller.feedback(Encoder(0.1 / step, 40 * step))  # type: ignore[attr-defined]
    stalled: list[int] = []

    def fed() -> None:
        feed()
        if not stalled and job.next >= 20:
            stalled.append(emulated.clock.now())
            emulated.controller.stall(stalled[0])

    feed = job.player.feed
    job.player.feed = fed  # type: ignore[method-assign]
    if not feedback:
        assert job.run() is PrintState.COMPLETE and stalled, "nobody saw it"
        return
    with pytest.raises(InterlockOpen, match="switched the light off: stall, the encoder differs"):
        job.run()
    assert not emulated.controller.light
    speed = float(schedule.speed / schedule.advance) * STEPS
    assert emulated.controller.intervals[-1][1] - stalled[0] <= 51 / speed * 1e9


def _long_web(path: Path, mm: float, speed: float = 0.8) -> tuple[Schedule, Print]:
    """A print of so much web [mm] at a speed [mm/s], whose recorder keeps nothing."""
    advance = 9.0 * pi / 360
    schedule = web(int(mm / advance), advance=advance, speed=speed, engines=MIRRORS)
    emulated, _, job = made(schedule, path, replace(MODEL, planes=2000))
    emulated.recorder.shown = lambda engine, shown: None  # type: ignore[method-assign]
    return schedule, job


def _of_the_host() -> int:
    """Memory that the host holds [bytes]; the emulators' logs of their last acts fill up first."""
    others = tracemalloc.Filter(False, "*/hosts/emulators/*"), tracemalloc.Filter(False, tracemalloc.__file__)
    return sum(trace.size for trace in tracemalloc.take_snapshot().filter_traces(others).traces)


@pytest.mark.slow
def test_a_host_keeps_nothing_of_a_slot_that_was_shown(tmp_path: Path) -> None:
    """Its tables are made before the light; what was shown goes to the disk, whose record of a slot is the bound."""
    assert _long_web(tmp_path / "first", 5)[1].run() is PrintState.COMPLETE  # imports and caches
    schedule, job = _long_web(tmp_path / "run", 40)
    held: dict[int, int] = {}
    tracemalloc.start()
    try:
        with job.guard:
            job.begin(0)
            while job.step():
                job.player.wait()
                if (at := job.next) in (len(schedule) // 4, 3 * len(schedule) // 4):
                    held.setdefault(at, _of_the_host())
        (first, before), (last, after) = held.items()
        assert after - before < FRAME_RECORD.itemsize * (last - first), (before, after)
    finally:
        tracemalloc.stop()


def test_the_account_of_a_long_print_takes_its_record_and_its_light(tmp_path: Path) -> None:
    """For each slot: its record as it is read, and eight numbers of 64 bits to add up its light."""
    slots = 20_000
    with RunFolder.begin(tmp_path / "run", {}, "") as folder:
        for slot in range(slots):
            folder.shown(FrameRecord(slot, slot, slot, slot, 1000))
        tracemalloc.start()
        try:
            found = account(read_run(tmp_path / "run"), np.full(slots, 1000))
            most = tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()
    assert found is not None and found.complete
    assert most < slots * (FRAME_RECORD.itemsize + 8 * 8), most / slots


def test_a_web_printed_from_its_middle_is_incomplete(tmp_path: Path) -> None:
    schedule, job = _long_web(tmp_path / "run", 20)
    first = 3 * len(schedule) // 4
    assert job.run(first) is PrintState.INCOMPLETE, "the first of it was never lit"
    shown = read_run(tmp_path / "run").shown
    assert shown["slot"].tolist() == list(range(first, len(schedule))) and not shown["dark"].any()


def test_slots_beyond_16_bits_are_counted(tmp_path: Path) -> None:
    schedule, job = _long_web(tmp_path / "run", 5_200, speed=8.0)
    assert len(schedule) == 66_208 > 2**16
    assert job.run(65_000) is PrintState.INCOMPLETE
    shown = read_run(tmp_path / "run").shown
    assert shown["slot"].tolist() == list(range(65_000, len(schedule))) and not shown["dark"].any()

"""Frames on their way: packed by another thread than prints, the same bytes either way, and late ones are judged."""

from __future__ import annotations

import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vamgpu.errors import TimingInfeasible, Underrun, WrongDevice
from vamgpu.hosts.drivers.dmd import Dmd
from vamgpu.hosts.drivers.memory import MirrorMemory
from vamgpu.hosts.emulators.alp import EmulatedAlp
from vamgpu.hosts.emulators.array import ArrayModel
from vamgpu.hosts.emulators.clock import VirtualClock
from vamgpu.hosts.frames.lateness import WebLatePolicy
from vamgpu.hosts.frames.packer import DevicePacker, PlanePacker, packer
from vamgpu.hosts.frames.sources import MirrorArray, VialFrames
from vamgpu.hosts.frames.upload import BUFFERS, HELD, UploadQueue, guard, length
from vamgpu.hosts.player.machines import MirrorMachines
from vamgpu.hosts.rig import check, plan, rehearsal
from vamgpu.hosts.rigs.config import read_rig
from vamgpu.hosts.rigs.preflight import judged
from vamgpu.hosts.schedules.clock import RealClock
from vamgpu.hosts.schedules.limits import MirrorTiming
from vamgpu.hosts.schedules.mirrors import turned
from vamgpu.hosts.schedules.schedule import NONE
from vamgpu.printing.folder import save_frames
from vamgpu.printing.frames import Frames
from vamgpu.printing.gray import GrayCurve

MIRRORS = MirrorArray(12, 64, 8)
SHAPE = (8, 12, 8)
SCHEDULE = turned(40, speed=40, engines=MirrorTiming(pixels=(64, 12), row_bytes=8, dark=3e-3))


def frames_of(device: str) -> Frames:
    levels = np.random.default_rng(5).integers(0, 256, (40, 8, 30), dtype=np.uint8)
    return Frames.from_bytes(levels, device, bits=8, gray=GrayCurve.linear(), scale=1.0, columns=30)


def test_a_host_holds_a_second_of_frames_or_what_it_can_afford() -> None:
    full = 8 * 1080 * 256
    assert length(30.6, full) == 31
    assert length(3000.0, full) == guard(3000.0) == 180  # fewer would be given up before they are sent
    assert length(2000.0, full) == HELD // full == 121


class Watched:
    """Frames that keep which threads packed them, and may wait."""

    bits = 8

    def __init__(self, allowed: int) -> None:
        self._frames, self.threads, self.allowed = VialFrames(frames_of("numpy"), MIRRORS), set(), allowed
        self.go = threading.Event()

    def planes(self, numbers: np.ndarray) -> np.ndarray:
        self.threads.add(threading.get_ident())
        if self.allowed <= 0:
            self.go.wait()
        self.allowed -= 1
        return self._frames.planes(numbers)

    def frame(self, number: int) -> np.ndarray:
        return self._frames.frame(number)


def upload(frames: Any, policy: WebLatePolicy) -> tuple[UploadQueue, EmulatedAlp, VirtualClock]:
    clock = VirtualClock()
    alp = EmulatedAlp(clock, ArrayModel(height=12, width=64))
    dmd = Dmd(alp.library)
    dmd.slave()
    queue = UploadQueue(
        packer(frames, SHAPE, 40, 4), SCHEDULE.frame, MirrorMemory(dmd, 4, 8), RealClock(), batch=4, depth=BUFFERS,
        poses=SCHEDULE.pose, policy=policy, guard=guard(SCHEDULE.rate),
    )  # fmt: skip
    queue.start()
    return queue, alp, clock


def until(done: Any, act: Any) -> None:
    """Act until it is done, however long threads take on a busy machine."""
    while not done():
        act()
        time.sleep(0.001)


def test_device_and_host_pack_the_same_bytes(processor: str) -> None:
    packed = PlanePacker(VialFrames(frames_of("numpy"), MIRRORS), SHAPE, 40)
    made = packer(VialFrames(frames_of(processor), MIRRORS), SHAPE, 40, 4)
    assert isinstance(made, DevicePacker)
    numbers, one, two = np.array([7, NONE, 39]), np.full((4, *SHAPE), 9, np.uint8), np.full((4, *SHAPE), 9, np.uint8)
    packed.read(numbers, one)
    made.read(numbers, two)
    assert np.array_equal(one, two) and not one[[1, 3]].any()
    weights, levels = 1 << np.arange(7, -1, -1), frames_of("numpy").levels()
    shown = np.tensordot(weights, np.unpackbits(one[[0, 2]], axis=-1), (0, 1))
    assert np.array_equal(shown[:, *MIRRORS.place(8, 30)], levels[[7, 39]]) and shown.sum() == levels[[7, 39]].sum()


def test_the_thread_that_prints_packs_nothing() -> None:
    frames = Watched(100)
    mirrors, _, _ = upload(frames, WebLatePolicy())
    until(lambda: mirrors.primed, mirrors.prime)
    mirrors.prime()  # counts what was uploaded since
    assert mirrors.ahead == 8 and mirrors.share == 1.0 and mirrors.arrival(7) > 0
    mirrors.close()
    assert frames.threads and threading.get_ident() not in frames.threads


def test_late_frames_are_black_and_the_third_pose_ends_the_print() -> None:
    frames = Watched(2)  # eight frames come, the rest hangs
    mirrors, alp, clock = upload(frames, WebLatePolicy())
    until(lambda: mirrors.ahead == 8, mirrors.prime)

    def step() -> None:
        clock.sleep(30_000_000)
        alp.trigger(clock.now())
        mirrors.feed()

    with pytest.raises(Underrun, match="more than 2 of 360 angles"):
        until(lambda: False, step)
    assert [mirrors.was_black(slot) for slot in range(7, 12)] == [False, True, True, True, False]
    frames.go.set()
    mirrors.close()


def test_a_plan_is_checked_before_the_light(tmp_path: Path) -> None:
    place = save_frames(tmp_path / "part.vam", frames_of("numpy")).path
    planned = plan(place, read_rig("emulated"), speed=40, turns=1)
    stand = rehearsal(planned)
    machines, found = stand.machines, check(planned, stand.machines)
    assert isinstance(machines, MirrorMachines) and found is not None
    assert found.depth == round(planned.schedule.rate) and found.sequences == 11 and "instantaneous" in str(found)
    free = machines.mirrors[0].free_planes()
    real = check(planned, replace(machines, clock=RealClock()), 0.02)
    assert real is not None and np.isfinite(real.found[0].measured) and "all at the mirrors" in str(real)
    assert real.sequences * real.depth >= 40, "what fits is loaded before the light"
    assert machines.mirrors[0].free_planes() == free and not stand.emulated.controller.light
    with pytest.raises(WrongDevice, match="another device"):
        check(replace(planned, mirrors=(MIRRORS,)), machines)


def test_a_wire_that_is_too_slow_is_told_before_the_light() -> None:
    """Prints of Python's own ask the same of their mirrors."""
    dmd = Dmd(EmulatedAlp(VirtualClock(), ArrayModel(height=12, width=64, planes=160)).library)
    slow = dmd.call
    dmd.call = lambda name, *rest: (time.sleep(0.1) if name == "AlpSeqPut" else None, slow(name, *rest))[1]
    long = turned(4000, speed=20, engines=MirrorTiming(pixels=(64, 12), row_bytes=8))
    with pytest.raises(TimingInfeasible, match="the wire carries") as told:
        judged(long, [dmd], RealClock(), seconds=0.1)
    assert 0 < told.value.speed < 40 and told.value.limit == "data link"

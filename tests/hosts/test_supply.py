"""Pictures on their way: packed by another thread than prints, the same bytes either way, and late ones are judged."""

from __future__ import annotations

import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vamgpu.errors import TimingInfeasible, Underrun, WrongDevice
from vamgpu.hosts.clock import RealClock
from vamgpu.hosts.drivers.dmd import Dmd
from vamgpu.hosts.drivers.stream import PlaneStream
from vamgpu.hosts.emulators.array import ArrayModel
from vamgpu.hosts.emulators.clock import VirtualClock
from vamgpu.hosts.emulators.dmd import FakeAlp
from vamgpu.hosts.pictures.sources import FrameSource
from vamgpu.hosts.pictures.stream import FramePictures, Mirrors, PackedSource, source
from vamgpu.hosts.pictures.supply import HELD, Supply, guard, length
from vamgpu.hosts.pictures.underrun import WebUnderrun
from vamgpu.hosts.players.mirrors import Machines
from vamgpu.hosts.rig import check, plan, rehearsal
from vamgpu.hosts.rigs.config import read_rig
from vamgpu.hosts.rigs.preflight import judged
from vamgpu.hosts.schedules.limits import MirrorTiming
from vamgpu.hosts.schedules.moving import turned
from vamgpu.hosts.schedules.schedule import NONE
from vamgpu.printing.folder import save_frames
from vamgpu.printing.frames import Frames
from vamgpu.printing.gray import GrayCurve

MIRRORS = Mirrors(12, 64, 8)
SHAPE = (8, 12, 8)
SCHEDULE = turned(40, speed=40, engines=MirrorTiming(pixels=(64, 12), row_bytes=8, dark=3e-3))


def frames_of(device: str) -> Frames:
    levels = np.random.default_rng(5).integers(0, 256, (40, 8, 30), dtype=np.uint8)
    return Frames.from_bytes(levels, device, bits=8, gray=GrayCurve.linear(), scale=1.0, columns=30)


def test_a_host_holds_a_second_of_pictures_or_what_it_can_afford() -> None:
    full = 8 * 1080 * 256
    assert length(30.6, full) == 31
    assert length(3000.0, full) == guard(3000.0) == 180  # fewer would be given up before they are sent
    assert length(2000.0, full) == HELD // full == 121


class Watched:
    """Pictures that keep which threads packed them, and may wait."""

    bits = 8

    def __init__(self, allowed: int) -> None:
        self._pictures, self.threads, self.allowed = FramePictures(frames_of("numpy"), MIRRORS), set(), allowed
        self.go = threading.Event()

    def planes(self, numbers: np.ndarray) -> np.ndarray:
        self.threads.add(threading.get_ident())
        if self.allowed <= 0:
            self.go.wait(10)
        self.allowed -= 1
        return self._pictures.planes(numbers)

    def picture(self, number: int) -> np.ndarray:
        return self._pictures.picture(number)


def supply(pictures: Any, policy: WebUnderrun) -> tuple[Supply, FakeAlp, VirtualClock]:
    clock = VirtualClock()
    alp = FakeAlp(clock, ArrayModel(height=12, width=64))
    dmd = Dmd(alp.library)
    dmd.slave()
    stream = PlaneStream(dmd, 4, 8)
    slots = SCHEDULE.frame, SCHEDULE.pose
    return Supply(stream, pictures, *slots, RealClock(), SCHEDULE.rate, policy=policy, threaded=True), alp, clock


def until(done: Any, act: Any) -> None:
    end = time.monotonic() + 20
    while not done():
        act()
        assert time.monotonic() < end, "what was waited for never came"
        time.sleep(0.001)


def test_device_and_host_pack_the_same_bytes() -> None:
    packed = PackedSource(FramePictures(frames_of("numpy"), MIRRORS), SHAPE, 40)
    made = source(FramePictures(frames_of("opencl:pocl:0"), MIRRORS), SHAPE, 40, 4)
    assert isinstance(made, FrameSource)
    numbers, one, two = np.array([7, NONE, 39]), np.full((4, *SHAPE), 9, np.uint8), np.full((4, *SHAPE), 9, np.uint8)
    packed.read(numbers, one)
    made.read(numbers, two)
    assert np.array_equal(one, two) and not one[[1, 3]].any()
    weights, levels = 1 << np.arange(7, -1, -1), frames_of("numpy").levels()
    shown = np.tensordot(weights, np.unpackbits(one[[0, 2]], axis=-1), (0, 1))
    assert np.array_equal(shown[:, *MIRRORS.place(8, 30)], levels[[7, 39]]) and shown.sum() == levels[[7, 39]].sum()


def test_the_thread_that_prints_packs_nothing() -> None:
    pictures = Watched(100)
    mirrors, _, _ = supply(pictures, WebUnderrun())
    until(lambda: mirrors.primed, mirrors.prime)
    mirrors.prime()  # counts what was uploaded since
    assert mirrors.ahead == 8 and mirrors.share == 1.0 and mirrors.arrived(7) > 0
    mirrors.close()
    assert pictures.threads and threading.get_ident() not in pictures.threads


def test_late_pictures_are_black_and_the_third_pose_ends_the_print() -> None:
    pictures = Watched(2)  # eight pictures come, the rest hangs
    mirrors, alp, clock = supply(pictures, WebUnderrun())
    until(lambda: mirrors.ahead == 8, mirrors.prime)

    def step() -> None:
        clock.sleep(30_000_000)
        alp.trigger(clock.now())
        mirrors.fill()

    with pytest.raises(Underrun, match="more than 2 of 360 poses"):
        until(lambda: False, step)
    assert [mirrors.black(slot) for slot in range(7, 12)] == [False, True, True, True, False]
    pictures.go.set()
    mirrors.close()


def test_a_plan_is_checked_before_the_light(tmp_path: Path) -> None:
    place = save_frames(tmp_path / "part.vam", frames_of("numpy")).path
    planned = plan(place, read_rig("emulated"), speed=40)
    stand = rehearsal(planned)
    machines, found = stand.machines, check(planned, stand.machines)
    assert isinstance(machines, Machines) and found is not None
    assert found.depth == round(planned.schedule.rate) and found.sequences == 2 and "takes no time" in str(found)
    free = machines.mirrors[0].free_planes()
    real = check(planned, replace(machines, clock=RealClock()), 0.02)
    assert real is not None and np.isfinite(real.found[0].measured) and "all at the mirrors" in str(real)
    assert real.sequences * real.depth >= 40, "what fits is loaded before the light"
    assert machines.mirrors[0].free_planes() == free and not stand.bench.controller.light
    with pytest.raises(WrongDevice, match="another device"):
        check(replace(planned, mirrors=(MIRRORS,)), machines)


def test_a_wire_that_is_too_slow_is_told_before_the_light() -> None:
    """Prints of Python's own ask the same of their mirrors."""
    dmd = Dmd(FakeAlp(VirtualClock(), ArrayModel(height=12, width=64, planes=160)).library)
    slow = dmd.call
    dmd.call = lambda name, *rest: (time.sleep(0.1) if name == "AlpSeqPut" else None, slow(name, *rest))[1]
    long = turned(4000, speed=20, engines=MirrorTiming(pixels=(64, 12), row_bytes=8))
    with pytest.raises(TimingInfeasible, match="the wire carries") as told:
        judged(long, [dmd], RealClock(), seconds=0.1)
    assert 0 < told.value.speed < 40 and told.value.limit == "data link"

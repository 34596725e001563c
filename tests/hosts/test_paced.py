"""Prints in real time, with threads that make and upload frames, on emulated machines that keep pace."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from math import pi
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vamgpu.errors import Underrun
from vamgpu.hosts.emulators.array import ArrayModel
from vamgpu.hosts.emulators.clock import PacedClock
from vamgpu.hosts.emulators.rigs import EmulatedMirrorRig
from vamgpu.hosts.player.controller_mirrors import TriggeredPlayer
from vamgpu.hosts.player.run import Print, SafetyLimits
from vamgpu.hosts.records.record import RunFolder, read_run
from vamgpu.hosts.records.state import PrintState
from vamgpu.hosts.schedules.clock import RealClock
from vamgpu.hosts.schedules.limits import MirrorTiming
from vamgpu.hosts.schedules.mirrors import web
from vamgpu.hosts.schedules.timing import SECOND

MODEL = ArrayModel(height=2, width=16)
MIRRORS = MirrorTiming(pixels=(16, 2), row_bytes=2, dark=4e-3)
PATIENT = SafetyLimits(lease=SECOND)
"""A lease that a busy machine holds."""


class White:
    """Frames that are full on, made in any thread, until they are held back."""

    bits = 8

    def __init__(self, most: int = 10_000) -> None:
        self.threads: set[int] = set()
        self.most, self.go, self.held = most, threading.Event(), threading.Event()

    def planes(self, numbers: np.ndarray) -> np.ndarray:
        self.threads.add(threading.get_ident())
        if numbers.max() >= self.most:
            self.held.set()
            self.go.wait(30)
        return np.full((len(numbers), 8, 2, 2), 255, np.uint8)

    def frame(self, number: int) -> np.ndarray:
        return np.full((2, 16), 255, np.uint8)


class PatientTime(RealClock):
    """Time that hardly passes while threads owe frames, and else in short steps: a busy machine is slow, not late."""

    def __init__(self, owed: Callable[[], bool]) -> None:
        super().__init__()
        self._owed, self._seen, self._time, self._lock = owed, super().now(), 0, threading.Lock()

    def now(self) -> int:
        with self._lock:
            seen = super().now()
            self._time += min(seen - self._seen, SECOND // 50) // (30 if self._owed() else 1)
            self._seen = seen
            return self._time

    def sleep_until(self, until: int) -> None:
        while (left := until - self.now()) > 0:
            time.sleep(min(left * 1e-9, 0.01))


def printed(path: Path, frames: White, poses: int) -> tuple[Print, EmulatedMirrorRig]:
    schedule = web(poses, advance=9 * pi / 360, speed=1.6, engines=MIRRORS)
    clock, triggers = PacedClock(), [0]
    emulated = EmulatedMirrorRig(1000, MODEL, clock=clock)
    player = TriggeredPlayer(schedule, emulated.machines(1000 / float(schedule.advance)), [frames], depth=8)

    def owed() -> bool:
        return not frames.held.is_set() and any(
            not queue.done and queue.uploaded < triggers[0] + 4 for queue in player._queues
        )

    trigger = emulated.controller.on_trigger
    assert trigger is not None

    def counted(*arguments: Any) -> None:
        triggers[0] += 1
        trigger(*arguments)

    emulated.controller.on_trigger = counted
    clock._own, clock._began = PatientTime(owed), 0
    return Print(player, RunFolder.begin(path, {}, ""), limits=PATIENT), emulated


@pytest.mark.slow
def test_threads_make_and_upload_while_one_prints(tmp_path: Path) -> None:
    frames = White()
    job, emulated = printed(tmp_path / "run", frames, 60)
    began = time.monotonic()
    assert job.run() is PrintState.COMPLETE
    passed = time.monotonic() - began
    assert threading.get_ident() not in frames.threads and passed >= 1e-9 * job.player.schedule.duration
    job.folder.close()
    shown = read_run(tmp_path / "run").shown
    assert shown["slot"].tolist() == list(range(60)) and not shown["dark"].any()
    lit = emulated.recorder.seconds(0, 60)[0, :, 0, 0]
    assert np.abs(lit / np.median(lit) - 1).max() < 1e-3


@pytest.mark.slow
def test_a_source_that_hangs_in_its_thread_ends_the_print_dark(tmp_path: Path) -> None:
    frames = White(most=30)
    job, emulated = printed(tmp_path / "run", frames, 120)
    with pytest.raises(Underrun, match="more than 2 of 360 angles"):
        job.run()
    assert not emulated.controller.light and not any(t.name == "frames upload" for t in threading.enumerate())
    frames.go.set()
    job.folder.close()
    dark = read_run(tmp_path / "run").shown
    assert dark["dark"].sum() in (1, 2, 3) and dark["slot"][dark["dark"] > 0].min() >= 22

"""Prints in real time, with threads that make and upload pictures, on emulated machines that keep pace."""

from __future__ import annotations

import threading
import time
from math import pi
from pathlib import Path

import numpy as np
import pytest

from vamgpu.errors import Underrun
from vamgpu.hosts.emulators.array import ArrayModel
from vamgpu.hosts.emulators.bench import Bench
from vamgpu.hosts.emulators.clock import PacedClock
from vamgpu.hosts.players.triggered import TriggeredPlayer
from vamgpu.hosts.record import RunFolder, read_run
from vamgpu.hosts.run import Limits, Print
from vamgpu.hosts.schedules.limits import MirrorTiming
from vamgpu.hosts.schedules.moving import web
from vamgpu.hosts.schedules.timing import SECOND
from vamgpu.hosts.state import State

MODEL = ArrayModel(height=2, width=16)
MIRRORS = MirrorTiming(pixels=(16, 2), row_bytes=2, dark=4e-3)
PATIENT = Limits(lease=SECOND)
"""A lease that a busy machine holds."""


class White:
    """Pictures that are full on, made in any thread, until they are held back."""

    bits = 8

    def __init__(self, most: int = 10_000) -> None:
        self.threads: set[int] = set()
        self.most, self.go = most, threading.Event()

    def planes(self, numbers: np.ndarray) -> np.ndarray:
        self.threads.add(threading.get_ident())
        if numbers.max() >= self.most:
            self.go.wait(30)
        return np.full((len(numbers), 8, 2, 2), 255, np.uint8)

    def picture(self, number: int) -> np.ndarray:
        return np.full((2, 16), 255, np.uint8)


def printed(path: Path, pictures: White, poses: int) -> tuple[Print, Bench]:
    schedule = web(poses, advance=9 * pi / 360, speed=1.6, engines=MIRRORS)
    bench = Bench(1000, MODEL, clock=PacedClock())
    player = TriggeredPlayer(schedule, bench.machines(1000 / float(schedule.advance)), [pictures], depth=8)
    return Print(player, RunFolder.begin(path, {}, ""), limits=PATIENT), bench


def test_threads_make_and_upload_while_one_prints(tmp_path: Path) -> None:
    pictures = White()
    job, bench = printed(tmp_path / "run", pictures, 60)
    began = time.monotonic()
    assert job.run() is State.COMPLETE
    passed = time.monotonic() - began
    assert threading.get_ident() not in pictures.threads and passed >= 1e-9 * job.player.schedule.duration
    job.folder.close()
    shown = read_run(tmp_path / "run").shown
    assert shown["slot"].tolist() == list(range(60)) and not shown["dark"].any()
    lit = bench.chamber.seconds(0, 60)[0, :, 0, 0]
    assert np.abs(lit / np.median(lit) - 1).max() < 1e-3


def test_a_source_that_hangs_in_its_thread_ends_the_print_dark(tmp_path: Path) -> None:
    pictures = White(most=30)
    job, bench = printed(tmp_path / "run", pictures, 120)
    with pytest.raises(Underrun, match="more than 2 of 360 poses"):
        job.run()
    assert not bench.controller.light and not any(t.name == "feed upload" for t in threading.enumerate())
    pictures.go.set()
    job.folder.close()
    dark = read_run(tmp_path / "run").shown
    assert dark["dark"].sum() in (1, 2, 3) and dark["slot"][dark["dark"] > 0].min() >= 22

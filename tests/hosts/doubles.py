"""What tests of prints share: frames that are full on, a print on an emulated rig, and frames that are late."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vamgpu.hosts.emulators.array import ArrayModel
from vamgpu.hosts.emulators.rigs import EmulatedMirrorRig
from vamgpu.hosts.frames.upload import UploadQueue
from vamgpu.hosts.player import mirrors
from vamgpu.hosts.player.controller_mirrors import PREROLL, TriggeredPlayer
from vamgpu.hosts.player.run import Print
from vamgpu.hosts.process.resume import asked_for, limits
from vamgpu.hosts.process.versions import planned_versions
from vamgpu.hosts.records.record import RunFolder, RunRecord, read_run
from vamgpu.hosts.records.state import Board
from vamgpu.hosts.rig import PrintPlan, player, rehearsal
from vamgpu.hosts.schedules.limits import MirrorTiming
from vamgpu.hosts.schedules.mirrors import web
from vamgpu.hosts.schedules.schedule import Schedule

if TYPE_CHECKING:
    import pytest

STEPS = 1000
MODEL = ArrayModel(height=2, width=16)
MIRRORS = MirrorTiming(pixels=(16, 2), row_bytes=2, dark=1e-3)
LAB = """
[rig]
name = "lab"
machine = "vial"
[controller]
driver = "vam-controller"
port = "/dev/does-not-exist"
[motion]
driver = "controller"
microsteps = 3200.0
[display]
driver = "alp"
library = "/does/not/exist.so"
"""
"""A rig whose machines are not there."""


class White:
    """Frames that are full on."""

    bits = 8

    def planes(self, numbers: np.ndarray) -> np.ndarray:
        return np.full((len(numbers), 8, 2, 2), 255, np.uint8)

    def frame(self, number: int, engine: int = 0) -> np.ndarray:
        return np.full((2, 16), 255, np.uint8)


class Scene:
    """A print on an emulated rig. options: of `Print`."""

    def __init__(
        self, path: Path, schedule: Schedule, board: Board | None = None, *, powers: tuple[float, ...] = (),
        depth: int | None = None, **options: Any,
    ) -> None:  # fmt: skip
        self.path, self.schedule = path, schedule
        self.emulated = EmulatedMirrorRig(STEPS, MODEL, schedule.engines, powers)
        self.machines = self.emulated.machines(STEPS / float(schedule.advance))
        self.player = TriggeredPlayer(schedule, self.machines, [White()] * schedule.engines, depth=depth)
        self.print = Print(self.player, RunFolder.begin(path, {}, ""), board=board, **options)

    def until(self, slot: int) -> None:
        while self.print.next < slot:
            self.player.wait()
            assert self.print.step()

    def paused(self, slot: int = 5) -> None:
        with self.print.guard:
            self.print.begin(0)
            self.until(slot)
            self.print.pause()
            while self.print.step():
                self.player.wait()

    def lit(self) -> bool:
        return bool(self.emulated.controller.intervals) or bool(self.emulated.controller.light)

    def seconds(self, engine: int = 0, turn: int | None = None) -> np.ndarray:
        count = turn or len(self.schedule)
        return self.emulated.recorder.seconds(engine, count, turn)[:, :, 0, 0].sum(axis=0)

    def read(self) -> RunRecord:
        self.print.folder.close()
        return read_run(self.path)


def roll(poses: int = 60, speed: float = 0.8, **options: Any) -> Schedule:
    return web(poses, advance=0.0785, speed=speed, **{"engines": MIRRORS, **options})


def late(monkeypatch: pytest.MonkeyPatch, *feeds: set[int]) -> None:
    """Slots whose frames come after black was shown for them, for each upload queue in the order they begin."""
    begun: list[UploadQueue] = []

    class Late(UploadQueue):
        def make(self, timeout: float = 0.0) -> bool:
            if self not in begun:
                begun.append(self)
            slots = dict(enumerate(feeds)).get(begun.index(self), set())
            return False if self.made - PREROLL in slots and self.uploaded <= self.made else super().make(timeout)

    monkeypatch.setattr(mirrors, "UploadQueue", Late)


class Replaced:
    """A rehearsal whose frames are replaced while it is printed: what ``happens`` once a slot comes."""

    def __init__(self, path: Path, planned: PrintPlan, allowance: float = 10.0) -> None:
        self.path, self.planned, self.stand = path, planned, rehearsal(planned)
        self.versions = planned_versions(planned, allowance)
        self.play: Any = player(planned, self.stand.machines, None, None, self.versions)
        self.happens: dict[int, Callable[[], object]] = {}

    def run(self, **options: Any) -> RunRecord:
        feed = self.play.feed

        def fed() -> None:
            for slot in [slot for slot in self.happens if slot <= self.print.next]:
                self.happens.pop(slot)()
            feed()

        self.play.feed = fed
        with RunFolder.begin(self.path, asked_for(self.planned), self.planned.rig.text) as folder:
            self.print = Print(self.play, folder, limits=limits(self.planned.rig), **options)
            self.print.run()
        return read_run(self.path)

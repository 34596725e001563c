"""Hosts that die one after the other, at any moment: no slot is lit twice, none left out that is not told as unseen."""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from chances import RIGHTLY, Died, Life, on_its_days
from doubles import MIRRORS, MODEL, STEPS, White

from vamgpu.errors import BadInput
from vamgpu.hosts.emulators.rigs import EmulatedMirrorRig
from vamgpu.hosts.player.controller_mirrors import TriggeredPlayer
from vamgpu.hosts.player.run import Print
from vamgpu.hosts.process.resume import interrupted
from vamgpu.hosts.records.record import RunFolder, read_run
from vamgpu.hosts.schedules.mirrors import turned, web
from vamgpu.hosts.schedules.schedule import Schedule
from vamgpu.hosts.schedules.timing import SECOND

SLOTS, HOSTS = 24, 4
PRINTS = {
    "web": web(SLOTS, advance=0.0785, speed=0.8, engines=MIRRORS),
    "two": web(SLOTS, advance=0.0785, speed=0.8, engines=(MIRRORS, MIRRORS)),
    "vial": turned(SLOTS, speed=60, engines=MIRRORS),
    "slow": turned(SLOTS, speed=20, engines=MIRRORS),  # frames are lit for longer than the lease
}


class Mortal:
    """A host whose life is what it asks the controller and writes to its folder."""

    def __init__(
        self,
        emulated: EmulatedMirrorRig,
        path: Path,
        schedule: Schedule,
        life: Life,
    ):
        self._path, self._schedule, self._life = path, schedule, life
        self._machines = emulated.machines(STEPS / float(schedule.advance))
        life.mortal(self._machines.controller, "ask")
        for dmd in self._machines.mirrors:  # an interpreter that is killed halts nothing
            any_dmd: Any = dmd
            any_dmd.halt = lambda halt=dmd.halt: None if life.dead else halt()

    def prints(self) -> bool:
        """Begin the print, or go on with it, with a pause at slot 6; False where it died."""
        job = None
        try:
            job, first = self._job()
            job.guard.__enter__()
            job.begin(first)
            while True:
                if job.next == 6 and job.asked is None:
                    job.pause()
                if not job.step():
                    if job.next == SLOTS:
                        return True
                    job._pausing = False
                    job.guard.__exit__(None, None, None)
                    job.guard.__enter__()
                    job.begin(job.next)
                job.player.wait()
        except Died:
            return False
        finally:
            if job is not None:
                job.guard._release_process()
                job.folder.close()

    def _job(self) -> tuple[Print, int]:
        frames = [White()] * self._schedule.engines
        if not self._path.exists():
            folder = RunFolder.begin(self._path, {}, "")
            self._life.mortal(folder, "_put")
            return Print(TriggeredPlayer(self._schedule, self._machines, frames), folder), 0
        left = interrupted(self._path, self._machines.controller, self._schedule)
        player = TriggeredPlayer(self._schedule, self._machines, frames, origin=left.origin)
        folder = RunFolder.again(self._path)
        self._life.mortal(folder, "_put")
        left.take_up(folder, self._schedule, player.clock.now())
        job = Print(player, folder)
        job.restore(read_run(self._path).shown, left.pause)
        return job, left.first


def lived(
    emulated: EmulatedMirrorRig, path: Path, schedule: Schedule, chance: random.Random, at_once: bool
) -> list[tuple[int, bool]]:
    """Print by hosts of which all but the last die; when each died."""
    whole = Life()
    assert Mortal(EmulatedMirrorRig(STEPS, MODEL, schedule.engines), path.with_name("whole"), schedule, whole).prints()
    deaths = []
    for left in reversed(range(chance.choice((2, HOSTS)))):
        moment = chance.randrange(1, 300 if deaths else len(whole.moments))
        if not deaths and chance.random() < 0.5:
            moment = chance.choice(whole.rare())
        deaths.append((moment, chance.random() < 0.5))
        if Mortal(emulated, path, schedule, Life(*(deaths[-1] if left else ()))).prints():
            return deaths
        if at_once:
            disconnect(emulated)
        emulated.clock.sleep(SECOND)
        disconnect(emulated)
    raise AssertionError("the last host lives")


def disconnect(emulated: EmulatedMirrorRig) -> None:
    for alp in emulated.alps:
        alp.disconnect()


@pytest.mark.parametrize("at_once", [False, pytest.param(True, marks=pytest.mark.slow)])
@pytest.mark.parametrize("kind", PRINTS)
@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_every_slot_is_lit_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str, at_once: bool, seed: int
) -> None:
    schedule, path = PRINTS[kind], tmp_path / "run"
    emulated = EmulatedMirrorRig(STEPS, MODEL, schedule.engines)
    on_its_days(monkeypatch, emulated.clock)
    try:
        deaths = lived(emulated, path, schedule, random.Random(seed), at_once)
    except BadInput as refused:
        deaths = []
        assert any(word in str(refused) for word in RIGHTLY), refused
    run = read_run(path)
    told = (event for event in run.events if event["event"] == "unseen")
    unseen = {slot for event in told for slot in range(event["first"], event["stop"])}
    for engine in range(schedule.engines):
        turn = SLOTS if schedule.unit == "deg" else None
        lit = emulated.recorder.seconds(engine, SLOTS, turn)[:, :, 0, 0].sum(axis=0) / (schedule.on[0] * 1e-9)
        assert lit.max() < 1.004, (deaths, lit)
        if deaths:
            short = set(np.flatnonzero(lit < 0.99).tolist())
            assert short <= unseen, (deaths, short, unseen)
            assert run.shown["slot"][run.shown["engine"] == engine].tolist() == list(range(SLOTS)), deaths

"""Hosts that die one after the other, at any moment: no slot is lit twice, none left out that is not told as unseen."""

from __future__ import annotations

import random
import re
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from doubles import MIRRORS, MODEL, STEPS, White

from vamgpu.errors import BadInput
from vamgpu.hosts.emulators.bench import Bench
from vamgpu.hosts.players.triggered import TriggeredPlayer
from vamgpu.hosts.record import RunFolder, read_run
from vamgpu.hosts.resume import interrupted
from vamgpu.hosts.run import Print
from vamgpu.hosts.schedules.moving import turned, web
from vamgpu.hosts.schedules.schedule import Schedule
from vamgpu.hosts.schedules.timing import SECOND

SLOTS, HOSTS = 24, 4
PRINTS = {
    "web": web(SLOTS, advance=0.0785, speed=0.8, engines=MIRRORS),
    "two": web(SLOTS, advance=0.0785, speed=0.8, engines=(MIRRORS, MIRRORS)),
    "vial": turned(SLOTS, speed=60, engines=MIRRORS),
    "slow": turned(SLOTS, speed=20, engines=MIRRORS),  # pictures are lit for longer than the lease
}


class Died(BaseException):
    """The host is no more."""


class Mortal:
    """A host that dies at one of the moments at which it asks the controller or writes to its folder.

    moment: which, or None for a host that lives.  after: whether it still does what it does then.
    """

    def __init__(self, bench: Bench, path: Path, schedule: Schedule, moment: int | None = None, after: bool = False):
        self._path, self._schedule, self._moment, self._after = path, schedule, moment, after
        self.moments: list[str] = []
        self._dead = False
        self._machines = bench.machines(STEPS / float(schedule.advance))
        controller: Any = self._machines.controller
        controller.ask = self._mortal(controller.ask)
        for dmd in self._machines.mirrors:  # an interpreter that is killed halts nothing
            any_dmd: Any = dmd
            any_dmd.halt = lambda halt=dmd.halt: None if self._dead else halt()

    def _mortal(self, act: Callable[..., Any]) -> Callable[..., Any]:
        def acts(*arguments: Any) -> Any:
            self.moments.append(str(arguments))
            now = len(self.moments) == self._moment
            self._dead = self._dead or now
            if self._dead and not (self._after and now):
                raise Died
            answer = act(*arguments)
            if self._dead:
                raise Died
            return answer

        return acts

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
        pictures = [White()] * self._schedule.engines
        if not self._path.exists():
            folder: Any = RunFolder.begin(self._path, {}, "")
            folder._put = self._mortal(folder._put)
            return Print(TriggeredPlayer(self._schedule, self._machines, pictures), folder), 0
        left = interrupted(self._path, self._machines.controller, self._schedule)
        player = TriggeredPlayer(self._schedule, self._machines, pictures, origin=left.origin)
        folder = RunFolder.again(self._path)
        folder._put = self._mortal(folder._put)
        left.take_up(folder, self._schedule, player.clock.now())
        job = Print(player, folder)
        job.recall(read_run(self._path).shown, left.rest)
        return job, left.first


def lived(bench: Bench, path: Path, schedule: Schedule, chance: random.Random, at_once: bool) -> list[tuple[int, bool]]:
    """Print by hosts of which all but the last die; when each died."""
    whole = Mortal(Bench(STEPS, MODEL, schedule.engines), path.with_name("whole"), schedule)
    assert whole.prints()
    often = re.compile("'(stat|row|lease)'|\"look\"|shown.bin")
    rare = [moment for moment, act in enumerate(whole.moments, 1) if not often.search(act)]
    deaths = []
    for left in reversed(range(chance.choice((2, HOSTS)))):
        moment = chance.randrange(1, 300 if deaths else len(whole.moments))
        if not deaths and chance.random() < 0.5:
            moment = chance.choice(rare)
        deaths.append((moment, chance.random() < 0.5))
        if Mortal(bench, path, schedule, *(deaths[-1] if left else ())).prints():
            return deaths
        if at_once:
            forsake(bench)
        bench.clock.sleep(SECOND)
        forsake(bench)
    raise AssertionError("the last host lives")


def forsake(bench: Bench) -> None:
    for alp in bench.alps:
        alp.forsake()


@pytest.mark.parametrize("at_once", [False, True], ids=["by the lease", "mirrors at once"])
@pytest.mark.parametrize("kind", PRINTS)
@pytest.mark.parametrize("seed", range(3))
def test_every_slot_is_lit_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str, at_once: bool, seed: int
) -> None:
    schedule, path = PRINTS[kind], tmp_path / "run"
    bench = Bench(STEPS, MODEL, schedule.engines)
    for module in ("resume", "record"):
        monkeypatch.setattr(f"vamgpu.hosts.{module}.time", SimpleNamespace(time=lambda: 1e9 + bench.clock.now() * 1e-9))
    try:
        deaths = lived(bench, path, schedule, random.Random(seed), at_once)
    except BadInput as refused:
        deaths = []
        rightly = ("standby", "has shown nothing", "has shown all", "is complete", "rested")
        assert any(word in str(refused) for word in rightly), refused
    run = read_run(path)
    told = (event for event in run.events if event["event"] == "unseen")
    unseen = {slot for event in told for slot in range(event["first"], event["stop"])}
    for engine in range(schedule.engines):
        turn = SLOTS if schedule.unit == "deg" else None
        lit = bench.chamber.seconds(engine, SLOTS, turn)[:, :, 0, 0].sum(axis=0) / (schedule.on[0] * 1e-9)
        assert lit.max() < 1.004, (deaths, lit)
        if deaths:
            short = set(np.flatnonzero(lit < 0.99).tolist())
            assert short <= unseen, (deaths, short, unseen)
            assert run.shown["slot"][run.shown["engine"] == engine].tolist() == list(range(SLOTS)), deaths

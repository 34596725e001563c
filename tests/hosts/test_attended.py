"""Prints with an operator: buttons, pauses that last too long, and a live preview.

A print waits for nobody, so each button is pressed at its moment: when the board shows it, in a thread of its own.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from doubles import MODEL

from vamgpu.hosts.emulators.rigs import EmulatedMirrorRig
from vamgpu.hosts.panel.view import refusal
from vamgpu.hosts.player.machines import senses
from vamgpu.hosts.player.operator import print_with_operator
from vamgpu.hosts.player.run import Print, SafetyLimits
from vamgpu.hosts.records.record import RunFolder, read_run
from vamgpu.hosts.records.state import Board, PrintState, Snapshot, WrongState
from vamgpu.hosts.rig import plan, player, rehearsal
from vamgpu.hosts.rigs.config import read_rig
from vamgpu.hosts.schedules.timing import SECOND
from vamgpu.printing.folder import save_frames
from vamgpu.printing.frames import Frames
from vamgpu.printing.gray import GrayCurve


class Attended:
    """A print on emulated machines, and what its operator does. ``at`` adds an act, which follows those before it."""

    def __init__(self, folder: Path) -> None:
        images = np.random.default_rng(4).integers(0, 256, (36, 6, 10), dtype=np.uint8)
        frames = Frames.from_bytes(images, "numpy", bits=8, gray=GrayCurve.linear(), scale=1.0, columns=10)
        planned = plan(save_frames(folder / "part.vam", frames).path, read_rig("emulated"), speed=120, turns=1)
        self.board, self.path = Board(), folder / "run"
        stand = rehearsal(planned)
        self.emulated, self.player = stand.emulated, player(planned, stand.machines)
        told = partial(senses, stand.machines)
        self.print = Print(self.player, RunFolder.begin(self.path, {}, ""), board=self.board, senses=told)
        self._acts: list[tuple[Callable[[Snapshot], bool], Callable[[], object]]] = []
        self._prints = threading.get_ident()
        self._show, self.board.show = self.board.show, self._shown  # type: ignore[method-assign]

    def at(self, state: PrintState, slot: int, act: Callable[[], object]) -> None:
        self.when(lambda now: now.state is state and now.slot >= slot, act)

    def when(self, shown: Callable[[Snapshot], bool], act: Callable[[], object]) -> None:
        self._acts.append((shown, act))

    def _shown(self, **fields: object) -> None:
        self._show(**fields)
        mine = threading.get_ident() == self._prints
        if mine and self._acts and self._acts[0][0](self.board.now):
            self._acts.pop(0)[1]()

    def press(self, name: str) -> None:
        with ThreadPoolExecutor(1) as page:
            page.submit(self.board.buttons[name]).result()

    def run(self) -> PrintState:
        ended = print_with_operator(self.print, self.board)
        assert not self._acts and not self.board.now.light
        self.print.folder.close()
        return ended


@pytest.fixture
def job(tmp_path: Path) -> Attended:
    return Attended(tmp_path)


def test_a_print_is_paused_and_goes_on_by_its_buttons(job: Attended) -> None:
    def pause() -> None:
        with pytest.raises(WrongState, match="only a paused"):
            job.press("resume")
        job.press("pause")

    def resume() -> None:
        assert not job.board.now.light and job.board.now.deadline is not None
        with pytest.raises(WrongState, match="only a running print"):
            job.press("pause")
        job.press("resume")

    job.at(PrintState.PRINTING, 5, pause)
    job.at(PrintState.PAUSED, 5, resume)
    assert job.run() is PrintState.COMPLETE
    run = read_run(job.path)
    assert run.shown["slot"].tolist() == list(range(36))
    assert len([event for event in run.events if event["event"] == "segment"]) == 2


def test_a_print_is_cancelled_in_a_pause(job: Attended) -> None:
    job.at(PrintState.PRINTING, 5, lambda: job.press("pause"))
    job.at(PrintState.PAUSED, 5, lambda: job.press("cancel"))
    assert job.run() is PrintState.CANCELLED


def test_a_pause_that_lasts_too_long_is_the_end(job: Attended) -> None:
    job.print.limits = SafetyLimits(resume=SECOND // 5)
    job.at(PrintState.PRINTING, 5, lambda: job.press("pause"))
    assert job.run() is PrintState.CANCELLED and "too long" in job.board.now.message


def test_the_enclosure_is_looked_at_in_the_dark_too(tmp_path: Path) -> None:
    job = Attended(tmp_path)
    controller, seen = job.emulated.controller, []

    def opened() -> None:
        assert job.board.now.interlock_closed and job.board.now.lens_temperature is None
        controller.open_interlock(job.emulated.clock.now())
        job.when(lambda now: now.interlock_closed is False, closed)

    def closed() -> None:
        seen.append(refusal(job.board.now, "resume"))
        controller.interlock_closed = True
        job.when(lambda now: now.interlock_closed is True, lambda: job.press("resume"))

    job.at(PrintState.PRINTING, 5, lambda: job.press("pause"))
    job.at(PrintState.PAUSED, 5, opened)
    assert job.run() is PrintState.COMPLETE
    assert seen == ["the enclosure is open: close it first"]


def test_a_lens_tells_its_temperature_where_it_has_a_sensor_and_a_dead_line_tells_nothing() -> None:
    emulated = EmulatedMirrorRig(1000, MODEL, 1, (0.0, 1.0))
    assert emulated.lens is not None
    emulated.lens.celsius = 31.5
    machines = emulated.machines(1.0)
    assert senses(machines) == {"interlock_closed": True, "lens_temperature": 31.5}
    emulated.lens.sensor = False
    emulated.port.unplug()
    assert senses(machines) == {"interlock_closed": None, "lens_temperature": None}


def test_who_presses_resume_twice_can_still_pause(job: Attended, monkeypatch: pytest.MonkeyPatch) -> None:
    prime = job.player.prime

    def slowly(first: int, alive: Callable[[], None]) -> int:
        if first:
            job.press("resume")  # nothing was seen to happen yet
        return prime(first, alive)

    monkeypatch.setattr(job.player, "prime", slowly)
    job.at(PrintState.PRINTING, 5, lambda: job.press("pause"))
    job.at(PrintState.PAUSED, 5, lambda: job.press("resume"))
    job.at(PrintState.PRINTING, 12, lambda: job.press("pause"))
    assert job.run() is PrintState.CANCELLED and "too long" in job.board.now.message, "it stays dark in the pause"
    assert 12 <= len(read_run(job.path).shown) < 36


def test_the_print_waits_for_no_frame_that_people_see(job: Attended, monkeypatch: pytest.MonkeyPatch) -> None:
    hangs, asked = threading.Event(), threading.Event()

    def frame(number: int, engine: int = 0) -> np.ndarray:
        asked.set()
        hangs.wait()
        raise OSError("the disk is gone")

    monkeypatch.setattr(job.player, "frame", frame)
    monkeypatch.setattr("vamgpu.hosts.player.operator.LEAVE", 0.0)
    job.at(PrintState.PRINTING, 5, asked.wait)
    assert job.run() is PrintState.COMPLETE
    hangs.set()
    assert job.board.now.preview is None
    assert not read_run(job.path).shown["dark"].any()


def test_people_see_the_frame_that_is_shown(job: Attended, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []
    seen: list[tuple[int, Any]] = []
    drawn, frame, show = threading.Event(), job.player.frame, job.board.show

    def shown(**fields: object) -> None:
        show(**fields)
        if "preview" in fields:
            assert job.board.now.preview is fields["preview"]
            seen.append((asked[-1], fields["preview"]))  # both by the thread that draws
            drawn.set()

    monkeypatch.setattr(job.board, "show", shown)
    monkeypatch.setattr(job.player, "frame", lambda number, engine=0: asked.append(number) or frame(number))
    job.at(PrintState.PRINTING, 5, drawn.wait)
    assert job.run() is PrintState.COMPLETE
    assert seen and all(np.array_equal(preview, frame(number)) for number, preview in tuple(seen))
    assert asked == sorted(asked)


def test_a_stop_while_a_poll_is_told_leaves_nothing_lit_on_the_page(
    job: Attended, monkeypatch: pytest.MonkeyPatch
) -> None:
    show, polls = job.board.show, list[object]()

    def shown(**fields: object) -> None:
        if "polled" in fields and len(polls) < 5:
            polls.append(fields["polled"])
            if len(polls) == 5:  # what was polled is on its way to the page
                with ThreadPoolExecutor(1) as page:
                    page.submit(job.board.stop, "emergency stop").result()
                assert not job.board.now.light
        show(**fields)
        assert len(polls) < 5 or not job.board.now.light

    monkeypatch.setattr(job.board, "show", shown)
    assert job.run() is PrintState.CANCELLED
    assert len(polls) == 5

"""Prints that a person attends: buttons, and rests that last too long."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vamgpu.hosts.attended import attended
from vamgpu.hosts.board import Board
from vamgpu.hosts.record import RunFolder, read_run
from vamgpu.hosts.rig import limits, plan, player, rehearsal
from vamgpu.hosts.rigs.config import read_rig
from vamgpu.hosts.run import Limits, Print
from vamgpu.hosts.schedules.timing import SECOND
from vamgpu.hosts.state import State, WrongState
from vamgpu.printing.folder import save_frames
from vamgpu.printing.frames import Frames
from vamgpu.printing.gray import GrayCurve


@pytest.fixture
def job(tmp_path: Path) -> tuple[Print, Board, Path]:
    images = np.random.default_rng(4).integers(0, 256, (36, 6, 10), dtype=np.uint8)
    frames = Frames.from_bytes(images, "numpy", bits=8, gray=GrayCurve.linear(), scale=1.0, columns=10)
    planned = plan(save_frames(tmp_path / "part.vam", frames).path, read_rig("emulated"), speed=120)
    board = Board()
    playing = player(planned, rehearsal(planned, paced=True).machines)
    held = Limits(lease=SECOND, resume=limits(planned.rig).resume)
    return Print(playing, RunFolder.begin(tmp_path / "run", {}, ""), limits=held, board=board), board, tmp_path / "run"


def until(done: Callable[[], bool]) -> None:
    end = time.monotonic() + 30
    while not done():
        assert time.monotonic() < end, "what was waited for never came"
        time.sleep(0.005)


def printing(job: Print, board: Board) -> tuple[threading.Thread, list[State]]:
    ended: list[State] = []
    thread = threading.Thread(target=lambda: ended.append(attended(job, board)), daemon=True)
    thread.start()
    until(lambda: board.now.slot >= 5)
    return thread, ended


def test_a_print_is_paused_and_goes_on_by_its_buttons(job: tuple[Print, Board, Path]) -> None:
    run, board, path = job
    thread, ended = printing(run, board)
    with pytest.raises(WrongState, match="only one that is paused"):
        board.buttons["resume"]()
    board.buttons["pause"]()
    until(lambda: board.now.state is State.PAUSED)
    assert not board.now.light
    with pytest.raises(WrongState, match="only one that prints"):
        board.buttons["pause"]()
    board.buttons["resume"]()
    thread.join(30)
    assert ended == [State.COMPLETE]
    run.folder.close()
    assert read_run(path).shown["slot"].tolist() == list(range(36))


def test_a_print_is_cancelled_at_rest(job: tuple[Print, Board, Path]) -> None:
    run, board, _ = job
    thread, ended = printing(run, board)
    board.buttons["pause"]()
    until(lambda: board.now.state is State.PAUSED)
    board.buttons["cancel"]()
    thread.join(30)
    assert ended == [State.CANCELLED] and not board.now.light


def test_a_rest_that_lasts_too_long_is_the_end(job: tuple[Print, Board, Path]) -> None:
    run, board, _ = job
    run.limits = Limits(lease=SECOND, resume=SECOND // 5)
    thread, ended = printing(run, board)
    board.buttons["pause"]()
    thread.join(30)
    assert ended == [State.CANCELLED] and "too long" in board.now.message


def test_who_presses_resume_twice_can_still_pause(job: tuple[Print, Board, Path], monkeypatch: Any) -> None:
    run, board, _ = job
    thread, ended = printing(run, board)
    board.buttons["pause"]()
    until(lambda: board.now.state is State.PAUSED)
    prime, ready = run.player.prime, threading.Event()

    def slowly(first: int, alive: Callable[[], None]) -> int:
        board.buttons["resume"]()  # nothing was seen to happen yet
        ready.set()
        return prime(first, alive)

    monkeypatch.setattr(run.player, "prime", slowly)
    board.buttons["resume"]()
    until(ready.is_set)
    until(lambda: board.now.state is State.PRINTING)
    board.buttons["pause"]()
    until(lambda: board.now.state is State.PAUSED)
    time.sleep(0.3)
    assert board.now.state is State.PAUSED and not board.now.light
    board.buttons["cancel"]()
    thread.join(30)
    assert ended == [State.CANCELLED]


def test_the_print_waits_for_no_picture_that_people_see(job: tuple[Print, Board, Path], monkeypatch: Any) -> None:
    run, board, path = job
    hangs, asked = threading.Event(), threading.Event()

    def picture(number: int) -> np.ndarray:
        asked.set()
        hangs.wait(60)
        raise OSError("the disk is gone")

    monkeypatch.setattr(run.player, "picture", picture)
    assert attended(run, board) is State.COMPLETE
    hangs.set()
    assert asked.is_set() and board.now.picture is None
    run.folder.close()
    assert not read_run(path).shown["dark"].any()


def test_people_see_the_picture_that_is_shown(job: tuple[Print, Board, Path]) -> None:
    run, board, _ = job
    seen: list[int] = []
    picture = run.player.picture
    run.player.picture = lambda number: seen.append(number) or picture(number)  # type: ignore[method-assign]
    assert attended(run, board) is State.COMPLETE
    assert seen and board.now.picture is not None
    assert np.array_equal(board.now.picture, picture(seen[-1])) and seen == sorted(seen)

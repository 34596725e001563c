"""Prints that a person attends: buttons, and rests that last too long."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path

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

"""Stops that come at odd times, light that others put out, and what a print's record and budget say then."""

from __future__ import annotations

import os
import signal
import threading
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from doubles import MIRRORS, Scene, late, roll

from vamgpu.errors import BadInput, StorageError
from vamgpu.hosts.player.controller_mirrors import PREROLL
from vamgpu.hosts.records.record import RunFolder, read_run
from vamgpu.hosts.records.state import Board, PrintState, WrongState
from vamgpu.hosts.safety.interlock import InterlockOpen
from vamgpu.hosts.schedules.limits import LensTiming
from vamgpu.hosts.schedules.mirrors import turned
from vamgpu.hosts.schedules.timing import SECOND


def test_a_stop_in_a_pause_is_not_forgotten(run: Path) -> None:
    scene = Scene(run, roll())
    scene.paused(3)
    before = len(scene.emulated.controller.intervals)
    scene.print.stop("at rest")
    scene.print.pause()
    assert scene.print.run() is PrintState.CANCELLED and scene.print.guard.fault == "at rest"
    assert len(scene.emulated.controller.intervals) == before, "no light after the stop"


def test_a_stop_while_a_resumed_print_gets_ready_is_not_forgotten(run: Path) -> None:
    scene = Scene(run, roll())
    scene.paused(3)
    before, wait = len(scene.emulated.controller.intervals), scene.emulated.clock.sleep_until

    def stopping(until: int) -> None:
        scene.emulated.clock.sleep_until = wait  # type: ignore[method-assign]
        scene.print.stop("in the run-up")
        wait(until)

    scene.emulated.clock.sleep_until = stopping  # type: ignore[method-assign]
    assert scene.print.run() is PrintState.CANCELLED
    assert len(scene.emulated.controller.intervals) == before and not scene.emulated.controller.light


def test_a_stop_before_the_print_exists_or_runs_is_not_forgotten(run: Path, tmp_path: Path) -> None:
    board = Board()
    board.stop("before")
    early = Scene(run, roll(), board)
    assert early.print.run() is PrintState.CANCELLED and not early.lit()
    late = Scene(tmp_path / "late", roll())
    late.print.stop("not yet")
    assert late.print.run() is PrintState.CANCELLED and not late.lit()
    assert late.read().message == "not yet"


def test_an_ended_print_does_not_run_again(run: Path) -> None:
    scene = Scene(run, roll(4))
    with pytest.raises(BadInput, match="not one of the 4 slots"):
        scene.print.run(4)
    scene.print.run()
    with pytest.raises(WrongState, match="is complete"):
        scene.print.run()


def test_light_that_somebody_puts_out_ends_the_print(run: Path) -> None:
    scene = Scene(run, roll())
    with scene.print.guard:
        scene.print.begin(0)
        scene.until(5)
        scene.print.guard.off("watchdog")
        with pytest.raises(InterlockOpen, match="it was turned off"):
            scene.until(60)
    shown = scene.read().shown
    assert (scene.seconds()[shown["slot"][shown["dark"] == 0]] > 0).all(), "lit is what the resin saw"


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_signals_that_end_a_process_cancel(run: Path, number: signal.Signals, request: pytest.FixtureRequest) -> None:
    request.addfinalizer(partial(signal.signal, number, signal.signal(number, signal.SIG_DFL)))
    scene = signalling(run, number)
    with pytest.raises(SystemExit):
        scene.print.run()
    assert not scene.emulated.controller.light and signal.getsignal(number) == signal.SIG_DFL
    found = scene.read()
    assert found.state is PrintState.CANCELLED and found.message == number.name


def test_a_print_outlives_its_terminal_where_that_is_asked(run: Path, request: pytest.FixtureRequest) -> None:
    """Under `nohup`, SIGHUP is ignored from the start."""
    request.addfinalizer(partial(signal.signal, signal.SIGHUP, signal.signal(signal.SIGHUP, signal.SIG_IGN)))
    assert signalling(run, signal.SIGHUP).print.run() is PrintState.COMPLETE


def signalling(run: Path, number: signal.Signals) -> Scene:
    """A print that hears a signal after its fifth frame."""
    scene = Scene(run, roll())
    wait = scene.player.wait

    def signalled() -> None:
        if scene.print.next == 5:
            os.kill(os.getpid(), number)
        wait()

    scene.player.wait = signalled  # type: ignore[method-assign]
    return scene


def test_what_was_shown_before_a_fault_is_kept(run: Path) -> None:
    scene = Scene(run, roll(speed=4.0))
    with scene.print.guard:
        scene.print.begin(0)
        scene.until(20)
        scene.emulated.lose_triggers = 1
        scene.emulated.clock.sleep(SECOND // 10)
        with pytest.raises(InterlockOpen) as error:
            scene.until(60)
    scene.print.ended(error.value)
    slots = scene.read().shown["slot"]
    assert len(slots) == scene.emulated.controller.shown - PREROLL and slots.tolist() == list(range(len(slots)))


def test_each_engine_has_its_own_power(run: Path) -> None:
    scene = Scene(run, turned(12, speed=40, engines=(MIRRORS, MIRRORS), power=(1.0, 0.25)))
    assert scene.print.run() is PrintState.COMPLETE
    assert scene.emulated.controller.powers == [65535, round(0.25 * 65535)]
    budget = scene.print.guard.budget
    assert budget is not None and budget.spent == pytest.approx(1.25e-9 * scene.schedule.on.sum())


def test_an_added_turn_lights_only_the_engine_that_missed(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    late(monkeypatch, set(), {10, 12, 14, 16, 18, 20})
    scene = Scene(run, turned(24, speed=40, engines=(MIRRORS, MIRRORS)), depth=2)
    assert scene.print.run() is PrintState.COMPLETE
    for engine in (0, 1):
        seconds = scene.seconds(engine, 24)
        assert np.abs(seconds / seconds[0] - 1).max() < 2e-3
    shown = scene.read().shown
    again = shown[(shown["slot"] >= 24) & (shown["on_time"] > 0)]
    assert set(again["engine"]) == {1} and len(again) == 6


@pytest.mark.parametrize("speed", [2.4, 5.0, 8.0])
def test_two_lost_poses_are_borne_at_any_rate(run: Path, monkeypatch: pytest.MonkeyPatch, speed: float) -> None:
    late(monkeypatch, {298, 398})
    scene = Scene(run, roll(500, speed), depth=50)
    assert scene.print.run() is PrintState.INCOMPLETE
    shown = scene.read().shown
    assert shown["slot"][shown["dark"] > 0].tolist() == [298, 398]


def test_a_full_disk_still_learns_how_the_print_ended(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene(run, roll())
    write, replace = os.write, os.replace

    def full(*_: object) -> int:
        raise OSError(28, "No space left on device")

    def replaced(draft: Any, place: Any) -> None:
        if (run / ".reserve").exists():
            raise OSError(28, "No space left on device")
        replace(draft, place)

    with scene.print.guard:
        scene.print.begin(0)
        scene.until(5)
        scene.print.folder._write = full
        monkeypatch.setattr("vamgpu.hosts.records.record.os.replace", replaced)
        with pytest.raises(StorageError) as error:
            scene.until(60)
    scene.print.ended(error.value)
    scene.print.folder._write = write
    assert scene.read().state is PrintState.HELD


def test_half_a_line_does_not_spoil_the_record(run: Path) -> None:
    folder = RunFolder.begin(run, {}, "")
    folder.event("one", 1)
    folder._write = lambda file, data: os.write(file, data[: len(data) // 2])
    with pytest.raises(StorageError, match="is full"):
        folder.event("two", 2)
    folder._write = os.write
    folder.event("three", 3)
    folder.close()
    assert [event["event"] for event in read_run(run).events] == ["one", "three"]


def test_a_lens_is_brought_back_to_its_focus_by_another_host(run: Path) -> None:
    powers = (0.0, 0.7, 1.4)
    schedule = roll(40, lens=LensTiming(settle=6e-3), focus=powers)
    for first in range(1, 7):
        scene = Scene(run.with_name(f"run{first}"), schedule, powers=powers)
        assert scene.print.run(first) is PrintState.INCOMPLETE
        assert scene.emulated.recorder.astray == 0.0


def test_light_of_an_earlier_host_counts(run: Path) -> None:
    scene = Scene(run, roll(20))
    assert scene.print.run() is PrintState.COMPLETE
    budget, shown = scene.print.guard.budget, scene.read().shown
    later = Scene(run.with_name("later"), roll(20))
    later.print.restore(shown, 0)
    assert budget is not None and later.print.guard.budget is not None
    assert later.print.guard.budget.spent == pytest.approx(budget.spent)


def test_a_board_may_be_told_in_the_midst_of_telling() -> None:
    board = Board()
    with board._lock:
        board.show(light=False)
    done: list[int] = []
    threading.Thread(target=lambda: (board.show(slot=1), done.append(1))).start()
    assert board.now.light is False

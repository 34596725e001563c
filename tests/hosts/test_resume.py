"""Prints that a host left, gone on with by another on the rig's own terms."""

from __future__ import annotations

import json
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from doubles import LAB

from vamgpu.cli import main
from vamgpu.errors import BadInput, TimingInfeasible
from vamgpu.hosts.drivers.controller_protocol import ControllerRow
from vamgpu.hosts.player.controller_mirrors import PREROLL
from vamgpu.hosts.player.run import Print
from vamgpu.hosts.process.resume import asked_for, left_by_a_host
from vamgpu.hosts.records.record import FrameRecord, RunFolder, read_run
from vamgpu.hosts.records.state import Board, PrintState
from vamgpu.hosts.rig import PrintPlan, Rehearsal, carry_out, check, limits, may_go_on, plan, player, rehearsal
from vamgpu.hosts.rigs.config import EMULATED, parse_rig, read_rig
from vamgpu.hosts.safety.interlock import InterlockOpen
from vamgpu.hosts.schedules.timing import SECOND


def planned(job: Path, *settings: str) -> PrintPlan:
    return plan(job, parse_rig(EMULATED, settings, source="emulated"), speed=40.0, turns=1)


def begun(wanted: PrintPlan, path: Path, frames: int) -> tuple[Rehearsal, Print]:
    """A print that has shown some frames and more, held by its host."""
    stand = rehearsal(wanted)
    job = Print(
        player(wanted, stand.machines), RunFolder.begin(path, asked_for(wanted), wanted.rig.text),
        limits=limits(wanted.rig),
    )  # fmt: skip
    job.guard.__enter__()
    job.begin(0)
    while job.next < frames:
        job.player.wait()
        assert job.step()
    return stand, job


def until(stand: Rehearsal, job: Print, frames: int) -> None:
    """The leg goes on, and nobody looks at it."""
    while stand.emulated.controller.shown < frames:
        job.lease.beat()
        job.lease.keep(force=True)
        stand.emulated.clock.sleep(SECOND // 100)


def pause(job: Print) -> int:
    """Let it rest, and hold its light again; the next slot."""
    job.pause()
    while job.step():
        job.player.wait()
    job.guard.__exit__(None, None, None)
    job._pausing = False
    job.guard.__enter__()
    return job.next


def gone(stand: Rehearsal, job: Print, at_once: bool = False) -> None:
    """The host dies; its lease runs out. at_once: the system takes its mirrors back before that."""
    job.guard._release_process()
    if at_once:
        stand.emulated.alps[0].disconnect()
    job.folder.close()
    stand.emulated.clock.sleep(SECOND)
    assert not stand.emulated.controller.light
    stand.emulated.alps[0].disconnect()


def died(wanted: PrintPlan, path: Path) -> tuple[Rehearsal, Any]:
    """A print whose host is gone in the midst, and the machines as the next host opens them."""
    stand, job = begun(wanted, path, 12)
    gone(stand, job)
    return stand, again(stand, wanted)


def again(stand: Rehearsal, wanted: PrintPlan) -> Any:
    """The machines, as another host opens them."""
    return stand.emulated.machines(stand.emulated.microsteps / float(wanted.schedule.advance))


def test_a_print_goes_on_and_all_its_light_is_counted(job: Path, tmp_path: Path) -> None:
    wanted = planned(job, "light.power=0.5")
    stand, machines = died(wanted, tmp_path / "run")
    before = len(read_run(tmp_path / "run").shown)
    state, again = carry_out(wanted, machines, tmp_path / "run", resume=True)
    run, budget = read_run(tmp_path / "run"), again.guard.budget
    assert state is PrintState.INCOMPLETE and run.shown["slot"].tolist() == list(range(36)) and before < 36
    assert budget is not None and budget.spent == pytest.approx(0.5e-9 * run.shown["on_time"].sum())
    assert run.asked["settings"] == ["light.power=0.5"] and stand.monitor.verdict().frames == 36


@pytest.mark.parametrize(
    ("settings", "told"),
    [(("light.power=0.6",), r"\[light\]"), (("light.power=0.5", "motion.microsteps=1600.0"), r"\[motion\]")],
)
def test_another_light_or_motion_is_refused(job: Path, tmp_path: Path, settings: tuple[str, ...], told: str) -> None:
    _, machines = died(planned(job, "light.power=0.5"), tmp_path / "run")
    with pytest.raises(BadInput, match=told):
        carry_out(planned(job, *settings), machines, tmp_path / "run", resume=True)


def test_what_leaves_the_light_as_it_is_may_change(job: Path, tmp_path: Path) -> None:
    _, machines = died(planned(job), tmp_path / "run")
    calmer = planned(job, "safety.resume=20 s", "camera_stage.middle=19 mm")
    assert carry_out(calmer, machines, tmp_path / "run", resume=True)[0] is PrintState.INCOMPLETE


def test_a_refusal_forgets_nothing(job: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whether machines were opened for it or not; the print still goes on."""
    path = tmp_path / "run"
    stand, _ = died(planned(job, "light.power=0.5"), path)
    shown = stand.emulated.controller.shown
    with pytest.raises(BadInput, match=r"\[light\].*--set 'light.power=0.5'"):
        may_go_on(planned(job), path)
    with pytest.raises(BadInput, match="speed 40.0 in place of 50.0"):
        may_go_on(plan(job, parse_rig(EMULATED, ("light.power=0.5",), source="emulated"), speed=50.0, turns=1), path)
    may_go_on(planned(job, "light.power=0.5"), path)
    wanted = planned(job, "light.power=0.5")
    for _ in range(2):
        stand.emulated.alps[0].disconnect()
        with monkeypatch.context() as patch, pytest.raises(TimingInfeasible, match="too slow"):
            patch.setattr("vamgpu.hosts.process.execution.judged", too_slow)
            check(wanted, again(stand, wanted))
    assert stand.emulated.controller.shown == shown
    stand.emulated.alps[0].disconnect()
    assert carry_out(wanted, again(stand, wanted), path, resume=True)[0] is PrintState.INCOMPLETE
    assert read_run(path).shown["slot"].tolist() == list(range(36))


def too_slow(*_: Any, **__: Any) -> None:
    raise TimingInfeasible("the wire is too slow", "upload", 1.0, "deg/s")


@pytest.mark.parametrize("stopped", [False, True])
def test_a_segment_that_nobody_wrote_down_is_known_after_refusals(job: Path, tmp_path: Path, stopped: bool) -> None:
    """The host died before its first look at a leg that was shown in part; others open the controller, or stop it."""
    wanted, path = planned(job), tmp_path / "run"
    stand, old = begun(wanted, path, 12)
    rested = pause(old)
    old.begin(rested)
    until(stand, old, PREROLL + 3)
    gone(stand, old)
    shown = stand.emulated.controller.shown - PREROLL
    for _ in range(2):
        machines = again(stand, wanted)
        if stopped:
            machines.controller.stop()
        found = left_by_a_host(wanted, machines, path)
        assert (found.unseen, found.first) == (rested, rested + shown) and shown >= 3
        stand.emulated.alps[0].disconnect()


def test_frames_that_another_program_played_are_not_taken_for_its_own(job: Path, tmp_path: Path) -> None:
    wanted, path = planned(job), tmp_path / "run"
    stand, machines = died(wanted, path)
    other = machines.controller
    other.mode("time")
    other.end(24)
    for number in range(24):
        other.row(ControllerRow(number, 1000 * number, None, 0, 0, 0))
    other.go(5)
    stand.emulated.clock.sleep(SECOND)
    assert other.status().shown == 24
    with pytest.raises(BadInput, match="another program used the controller"):
        left_by_a_host(wanted, machines, path)


@pytest.mark.parametrize("black", [0, 1, PREROLL])
def test_a_host_that_died_before_the_first_slot(job: Path, tmp_path: Path, black: int) -> None:
    wanted, path = planned(job), tmp_path / "run"
    stand, old = begun(wanted, path, 0)
    until(stand, old, black)
    gone(stand, old)
    assert stand.emulated.controller.shown == black
    state, _ = carry_out(wanted, again(stand, wanted), path, resume=True)
    assert state is PrintState.COMPLETE and read_run(path).shown["slot"].tolist() == list(range(36))


def test_what_the_last_lease_showed_is_told_as_unseen(job: Path, tmp_path: Path) -> None:
    """Mirrors that go dark with their program leave what the controller triggers until the lease is over black."""
    wanted, path = planned(job, "safety.lease=1 s"), tmp_path / "run"
    stand, old = begun(wanted, path, 12)
    gone(stand, old, at_once=True)
    board = Board()
    assert carry_out(wanted, again(stand, wanted), path, board, resume=True, go_on=lambda job: False)[0] is (
        PrintState.INCOMPLETE
    )
    run = read_run(path)
    assert board.now.doubt == run.doubt
    unseen = next(event for event in run.events if event["event"] == "unseen")
    lit = stand.emulated.recorder.seconds(0, 36, 36).sum(axis=(0, 2, 3))
    black = np.flatnonzero(lit == 0).tolist()
    assert black and set(black) <= set(range(unseen["first"], unseen["stop"]))
    assert run.shown["slot"].tolist() == list(range(36))


def test_a_frame_that_the_lease_cut_is_told_as_unseen(job: Path, tmp_path: Path) -> None:
    """It is lit for longer than the lease: the host that died had seen it begin."""
    rig = parse_rig(EMULATED, ("safety.resume=60 s",), source="emulated")
    wanted, path = plan(job, rig, speed=10.0, turns=1), tmp_path / "run"
    stand, old = begun(wanted, path, 12)
    gone(stand, old)
    found = left_by_a_host(wanted, again(stand, wanted), path)
    assert (found.unseen, found.first) == (11, 12)
    stand.emulated.alps[0].disconnect()
    assert carry_out(wanted, again(stand, wanted), path, resume=True)[0] is PrintState.INCOMPLETE
    frames = wanted.jobs[0].frames
    assert frames is not None
    lit = stand.emulated.recorder.seconds(0, 36, 36).sum(axis=(0, 2, 3)) / frames.levels().sum(axis=(1, 2))
    assert np.flatnonzero(np.abs(lit / np.median(lit) - 1) > 1e-3).tolist() == [11]
    unseen = [event for event in read_run(path).events if event["event"] == "unseen"]
    assert [(event["first"], event["stop"]) for event in unseen] == [(11, 12)]


def test_a_play_of_another_program_is_not_taken_for_a_segment_that_never_began(job: Path, tmp_path: Path) -> None:
    wanted, path = planned(job), tmp_path / "run"
    stand, old = begun(wanted, path, 12)
    rested = pause(old)
    old.player.start = lambda: None  # type: ignore[method-assign]
    old.begin(rested)
    gone(stand, old)
    machines = again(stand, wanted)
    assert left_by_a_host(wanted, machines, path).first == rested
    machines.controller.go(9)
    machines.controller.stop()
    with pytest.raises(BadInput, match="another program used the controller"):
        left_by_a_host(wanted, machines, path)


def test_a_clock_that_was_set_back_in_the_light_hides_no_rest(
    job: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    wanted, path, real, ahead = planned(job), tmp_path / "run", time.time, [3600.0]
    for module in ("process.resume", "records.record"):
        monkeypatch.setattr(f"vamgpu.hosts.{module}.time", SimpleNamespace(time=lambda: real() + ahead[0]))
    stand, old = begun(wanted, path, 6)
    ahead[0] = 0.0
    while old.next < 12:
        old.player.wait()
        assert old.step()
    gone(stand, old)
    ahead[0] = 20.0
    assert 20 * SECOND <= left_by_a_host(wanted, again(stand, wanted), path).pause <= 25 * SECOND
    stand.emulated.alps[0].disconnect()
    ahead[0] = 40.0
    with pytest.raises(BadInput, match="paused for 4"):
        left_by_a_host(wanted, again(stand, wanted), path)


def test_black_before_the_first_slot_is_no_light_after_a_pause(
    job: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second host dies in its black frames; the controller shows more until the lease is over."""
    wanted, path, real, later = planned(job, "safety.lease=1 s"), tmp_path / "run", time.time, [0.0]
    for module in ("process.resume", "records.record"):
        monkeypatch.setattr(f"vamgpu.hosts.{module}.time", SimpleNamespace(time=lambda: real() + later[0]))
    stand, machines = died(wanted, path)
    later[0] = 20.0
    left = left_by_a_host(wanted, machines, path)
    with RunFolder.again(path) as folder:
        left.take_up(folder, wanted.schedule, machines.clock.now())
        second = Print(player(wanted, machines, origin=left.origin), folder, limits=limits(wanted.rig))
        second.restore(read_run(path).shown, left.pause)
        second.guard.__enter__()
        second.begin(left.first)
        while stand.emulated.controller.shown < PREROLL:
            second.player.wait()
            assert second.step()
        gone(stand, second, at_once=True)
    assert stand.emulated.controller.shown > PREROLL
    later[0] = 25.0
    found = left_by_a_host(wanted, again(stand, wanted), path)
    assert found.first > left.first and found.pause >= 25 * SECOND


def test_a_pause_is_counted_over_several_hosts(job: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The second host dies before its light; the dark began with the first."""
    wanted, path, later = planned(job), tmp_path / "run", [0.0]
    real = time.time
    for module in ("process.resume", "records.record"):
        monkeypatch.setattr(f"vamgpu.hosts.{module}.time", SimpleNamespace(time=lambda: real() + later[0]))
    stand, machines = died(wanted, path)
    later[0] = 20.0
    left = left_by_a_host(wanted, machines, path)
    assert 20 * SECOND <= left.pause <= 25 * SECOND
    with RunFolder.again(path) as folder:
        left.take_up(folder, wanted.schedule, machines.clock.now())
        second = Print(player(wanted, machines, origin=left.origin), folder, limits=limits(wanted.rig))
        second.restore(read_run(path).shown, left.pause)
        second.guard.__enter__()
        second.player.start = lambda: None  # type: ignore[method-assign]
        second.begin(left.first)
        gone(stand, second)
    later[0] = 29.0
    may_go_on(wanted, path)
    later[0] = 45.0
    with pytest.raises(BadInput, match="paused for [45]"):
        left_by_a_host(wanted, again(stand, wanted), path)


def test_a_print_whose_every_poll_sees_frames_leaves_signs(job: Path, tmp_path: Path) -> None:
    stand, old = begun(planned(job), tmp_path / "run", 12)
    begin, seen = stand.emulated.clock.now(), old.player.poll()
    for slot in range(12, 30):
        stand.emulated.clock.sleep(SECOND // 10)
        old._keep(replace(seen, frames=(FrameRecord(slot, slot, slot, 0, 0),)))
    gone(stand, old)
    events = map(json.loads, (tmp_path / "run" / "events.jsonl").read_text().splitlines())
    looks = [event["at"] for event in events if event["event"] == "poll"]
    assert sum(at > begin for at in looks) == 3, "in 1.8 s, at least every 0.6"


def test_an_open_door_does_not_cost_the_print(job: Path, tmp_path: Path) -> None:
    wanted, path = planned(job), tmp_path / "run"
    stand, machines = died(wanted, path)
    stand.emulated.controller.open_interlock(stand.emulated.clock.now())
    with pytest.raises(InterlockOpen, match="close the enclosure"):
        carry_out(wanted, machines, path, resume=True)
    stand.emulated.controller.interlock_closed = True
    stand.emulated.alps[0].disconnect()
    assert carry_out(wanted, again(stand, wanted), path, resume=True)[0] is PrintState.INCOMPLETE


def test_the_command_asks_before_it_opens_machines(
    job: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    carry_out(planned(job), rehearsal(planned(job)).machines, tmp_path / "run")
    opened: list[int] = []
    monkeypatch.setattr("vamgpu.hosts.process.watch.started", lambda *_, **__: opened.append(1))
    rig = tmp_path / "lab.toml"
    rig.write_text(LAB)
    assert main(["print", str(job), "--rig", str(rig), "--resume", str(tmp_path / "run")]) == 1
    told = capsys.readouterr().err
    assert "the rig has other values in [controller], [motion], [display]" in told and not opened
    assert f"copy them from {str(tmp_path / 'run' / 'rig.toml')!r}" in told


def test_a_measured_turn_does_not_make_another_rig(job: Path, tmp_path: Path) -> None:
    rig, measured = tmp_path / "lab.toml", tmp_path / "lab.calibration" / "turn-2026-11-20T120000"
    rig.write_text(EMULATED)
    measured.mkdir(parents=True)
    (measured / "result.toml").write_text('calibration = "turn"\n[measured]\nratio = 1.01\nerror = 1e-5\n')
    wanted = plan(job, read_rig(rig), speed=40.0, turns=1)
    assert wanted.rig.setup.motion.microsteps != read_rig(rig).setup.motion.microsteps
    gone(*begun(wanted, tmp_path / "run", 12))
    may_go_on(wanted, tmp_path / "run")
    with pytest.raises(BadInput, match=r"other values in \[lens\]"):
        may_go_on(plan(job, read_rig(rig, ["lens.axis=0.1"]), speed=40.0, turns=1), tmp_path / "run")

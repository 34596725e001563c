"""Rigs and prints from the command line: rehearsals, stops, pauses, and bad input told as such."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from doubles import LAB

from vamgpu.cli import main
from vamgpu.errors import BadInput, DeviceNotFound, JobError, StorageError, TimingInfeasible
from vamgpu.hosts.frames.sources import MirrorArray
from vamgpu.hosts.player.run import Print
from vamgpu.hosts.records.record import FrameRecord, RunFolder, read_run
from vamgpu.hosts.records.state import Board, PrintState
from vamgpu.hosts.rig import PrintPlan, carry_out, opened, plan, player, rehearsal
from vamgpu.hosts.rigs.config import EMULATED, parse_rig, read_rig
from vamgpu.printing.folder import save_frames
from vamgpu.printing.frames import Frames
from vamgpu.printing.gray import GrayCurve


def planned(job: Path, speed: float = 40.0, turns: int = 1) -> PrintPlan:
    return plan(job, read_rig("emulated"), speed=speed, turns=turns)


def test_a_rehearsal_shows_every_byte(job: Path, tmp_path: Path) -> None:
    wanted = planned(job, turns=2)
    stand, board = rehearsal(wanted), Board()
    state, _ = carry_out(wanted, stand.machines, tmp_path / "run", board)
    verdict = stand.monitor.verdict()
    assert state is PrintState.COMPLETE and verdict.frames == 36 and verdict.greatest < 1e-6 and verdict.beside < 1e-9
    frames = wanted.jobs[0].frames
    assert frames is not None and np.array_equal(stand.seen(wanted).images.numpy(), frames.images.numpy())
    run = read_run(tmp_path / "run")
    assert (run.shown["late"] < 0).all(), "every frame was at the mirrors before its trigger"
    assert run.shown["frame"].tolist() == [*range(36), *range(36)] and run.asked["rig"] == "emulated"
    assert (run.path / "rig.toml").read_text() == EMULATED
    assert [event["to"] for event in run.events if event["event"] == "light"] == ["on", "off"]
    assert board.now.state is PrintState.COMPLETE and not board.now.light and board.now.spent == pytest.approx(1 / 1.01)


def test_a_rehearsal_repeats_exactly(job: Path, tmp_path: Path) -> None:
    for name in ("one", "two"):
        wanted = planned(job)
        carry_out(wanted, rehearsal(wanted).machines, tmp_path / name)
    assert (tmp_path / "one" / "shown.bin").read_bytes() == (tmp_path / "two" / "shown.bin").read_bytes()


def begun(wanted: PrintPlan, place: Path, at: int, act: str) -> tuple[Print, Any, RunFolder]:
    """A print to which something is done from its own frames, in the midst."""
    stand = rehearsal(wanted)
    folder = RunFolder.begin(place, {}, "")
    job = Print(player(wanted, stand.machines), folder)
    keep = folder.shown

    def kept(shown: FrameRecord) -> None:
        keep(shown)
        if shown.slot == at:
            getattr(job, act)()

    folder.shown = kept
    return job, stand.emulated, folder


def test_an_emergency_stop_is_dark_at_once(job: Path, tmp_path: Path) -> None:
    run, emulated, folder = begun(planned(job), tmp_path / "run", 5, "stop")
    assert run.run() is PrintState.CANCELLED
    assert not emulated.controller.light and not emulated.controller.armed and run.guard.fault == "emergency stop"
    folder.close()
    found = read_run(tmp_path / "run")
    assert found.state is PrintState.CANCELLED and len(found.shown) == 6


def test_a_pause_is_resumed_where_it_was(job: Path, tmp_path: Path) -> None:
    run, emulated, folder = begun(planned(job), tmp_path / "run", 9, "pause")
    assert run.run() is PrintState.PAUSED and not emulated.controller.light
    emulated.clock.sleep(5_000_000_000)
    assert run.run() is PrintState.COMPLETE
    folder.close()
    assert read_run(tmp_path / "run").shown["slot"].tolist() == list(range(36))


def test_a_long_pause_is_not_resumed(job: Path, tmp_path: Path) -> None:
    run, emulated, _ = begun(planned(job), tmp_path / "run", 9, "pause")
    run.run()
    emulated.clock.sleep(31_000_000_000)
    with pytest.raises(BadInput, match="decayed"):
        run.run()
    assert not emulated.controller.light and run.states.state is PrintState.ERROR


def test_a_missing_machine_is_an_error_and_never_a_simulation() -> None:
    with pytest.raises(DeviceNotFound, match="/dev/does-not-exist"):
        opened(parse_rig(LAB))


def test_bad_rigs_are_told(tmp_path: Path) -> None:
    for change, why in (
        (("[controller]", "[controler]"), "did you mean 'controller'"),
        (('"vam-controller"', '"emulated"'), r"rig, line \d+: controller: is emulated and motion is real"),
        (('port = "/dev/does-not-exist"\n', ""), r"rig, line \d+: controller: .*expected port"),
        (('library = "/does/not/exist.so"\n', ""), "add library"),
        (("[rig]", '[safety]\nlease = "0 furlongs"\n[rig]'), "furlongs"),
        (("[rig]", '[safety]\nlease = "1.1 s"\n[rig]'), "expected 20 ms to 1000 ms"),
        (("[rig]", '[safety]\nlease = "1 ms"\n[rig]'), "expected 20 ms to 1000 ms"),
        (("3200.0", "3.2e9"), "less than or equal to 1000000"),
        (("[display]", "ramp = 1e5\n[display]"), "expected at most 1e.08"),
        (("[display]", "channel = 0\n[display]"), "channel"),
    ):
        with pytest.raises(JobError, match=why):
            parse_rig(LAB.replace(*change))
    with pytest.raises(JobError, match="or the word emulated"):
        read_rig(tmp_path / "none.toml")


def test_jobs_that_do_not_fit_are_told(job: Path, tmp_path: Path) -> None:
    with pytest.raises(TimingInfeasible):
        planned(job, speed=4000.0)
    real = parse_rig(LAB.replace("3200.0", "8000"))
    with pytest.raises(TimingInfeasible, match="3.2e.05 microsteps/s.*move at 25 deg/s or slower"):
        plan(job, real, speed=40.0, device="numpy", turns=1)
    assert len(plan(job, real, speed=25.0, device="numpy", turns=1).schedule) == 36
    with pytest.raises(BadInput, match="another projector"):
        MirrorArray(4, 8, 1).place(6, 10)
    with pytest.raises(StorageError):
        planned(tmp_path / "nothing")


@pytest.mark.slow
def test_the_command(job: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["print", "demo", "--rig", "emulated", "--out", str(tmp_path / "demo.run")]) == 0
    told = capsys.readouterr().out
    assert "\ncomplete: " in told and "1.000 times the proved dose" in told
    assert (tmp_path / "demo.run" / "report.html").stat().st_size > 10_000
    (tmp_path / "lab.toml").write_text(LAB)
    assert main(["print", str(job), "--rig", str(tmp_path / "lab.toml"), "--turns", "1", "--out", "x"]) == 1
    assert "does-not-exist" in capsys.readouterr().err


@pytest.mark.parametrize("turns", ["1.5", "0.4", "two"])
def test_turns_that_are_not_whole_are_refused(
    turns: str, job: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main(["print", str(job), "--rig", "emulated", "--turns", turns, "--out", str(tmp_path / "run")])
    assert f"got {turns}; expected a whole number" in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "run").exists()


def test_a_print_that_was_stopped_has_the_status_of_a_command_that_was(
    job: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def pressed(wanted: PrintPlan, machines: Any, folder: Path, _: Any, *rest: Any, **named: Any) -> Any:
        board = Board()
        board.stop("pressed")
        return carry_out(wanted, machines, folder, board, *rest, **named)

    monkeypatch.setattr("vamgpu.hosts.process.order.carry_out", pressed)
    assert main(["print", str(job), "--rig", "emulated", "--turns", "1", "--out", str(tmp_path / "run")]) == 130
    assert "cancelled: 0 frames" in capsys.readouterr().out
    assert read_run(tmp_path / "run").message == "pressed"


def test_the_run_of_another_job_is_not_gone_on_with(job: Path, tmp_path: Path) -> None:
    images = np.random.default_rng(9).integers(0, 256, (36, 6, 10), dtype=np.uint8)
    frames = Frames.from_bytes(images, "numpy", bits=8, gray=GrayCurve.linear(), scale=1.0, columns=10)
    other = save_frames(tmp_path / "other.vam", frames).path
    wanted = planned(job)
    carry_out(wanted, rehearsal(wanted).machines, tmp_path / "run")
    another = planned(other)
    with pytest.raises(BadInput, match="digests"):
        carry_out(another, rehearsal(another).machines, tmp_path / "run", resume=True)


def test_commands_look_at_folders_first(
    job: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "part.run").mkdir()
    assert main(["print", str(job), "--rig", "emulated", "--out", "part.run"]) == 1
    assert main(["print", ".", "--rig", "emulated"]) == 1
    words = ["--turns", "1", "--panel", "--port", "99999", "--out", "x"]
    assert main(["print", str(job), "--rig", "emulated", *words]) == 1
    told = capsys.readouterr().err
    assert "exists" in told and "has no name" in told and "another host or port" in told

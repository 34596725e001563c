"""What a run really showed is proved from its record, and commands say by their status how a print ended."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vamgpu.cli import main
from vamgpu.cli.print import _left as left
from vamgpu.cli.print import _place as place_of
from vamgpu.cli.print import _status as status_of
from vamgpu.errors import BadInput, DeviceError, StorageError
from vamgpu.hosts.emulators.controller import EmulatedController
from vamgpu.hosts.records.proof import _jobs as jobs_of
from vamgpu.hosts.records.proof import prove_run
from vamgpu.hosts.records.record import RunRecord, digest, read_run
from vamgpu.hosts.records.state import Board, PrintState
from vamgpu.hosts.rigs.rehearsal import Rehearsal, rehearsal
from vamgpu.hosts.schedules.timing import SECOND

PART = """
[target]
shape = "boat"
height = "11.5 mm"
pitch = "800 um"
[beam]
pitch = "800 um"
[turntable]
angles = 36
[solve]
method = "lbfgs"
iterations = 3
"""


@pytest.fixture(scope="module")
def part(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small vial's job."""
    file = tmp_path_factory.mktemp("job") / "part.toml"
    file.write_text(PART)
    assert main(["solve", str(file), "--set", "solve.device=cpu"]) == 0
    return file.with_suffix(".vam")


class Door:
    """Opens the enclosure of a rehearsal in the midst of the print; closes it after a while, if at all."""

    def __init__(self, controller: EmulatedController, clock: Any, again: float | None) -> None:
        self._controller, self._clock = controller, clock
        start = clock.now() + 4 * SECOND
        self._acts = [(start, self._open)] + ([] if again is None else [(start + round(again * SECOND), self._close)])

    def _open(self, now: int) -> None:
        self._controller.open_interlock(now)

    def _close(self, now: int) -> None:
        self._controller.interlock_closed = True

    def due(self) -> int | None:
        return self._acts[0][0] if self._acts else None

    def advance(self, now: int) -> None:
        while self._acts and self._acts[0][0] <= now:
            self._acts.pop(0)[1](now)


def opened_door(monkeypatch: pytest.MonkeyPatch, again: float | None) -> None:
    """Rehearsals whose enclosure is opened once the print has lit some frames."""

    def doored(*planned: Any, **options: Any) -> Rehearsal:
        stand = rehearsal(*planned, **options)
        controller, clock = stand.emulated.controller, stand.emulated.clock
        light = controller.on_light

        def lit(channels: int, now: int) -> None:
            if channels and not hasattr(stand.emulated, "door"):
                stand.emulated.door = Door(controller, clock, again)
                clock.attach(stand.emulated.door)
            light(channels, now)

        controller.on_light = lit
        return stand

    monkeypatch.setattr("vamgpu.hosts.process.order.rehearsal", doored)


def printed(part: Path, run: Path, *words: str) -> int:
    return main(["print", str(part), "--rig", "emulated", "--turns", "1", "--out", str(run), *words])


@pytest.mark.slow
def test_a_complete_print_is_proved_as_planned(part: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert printed(part, tmp_path / "run") == 0
    (found,) = prove_run(tmp_path / "run", "cpu")
    assert found.run.state is PrintState.COMPLETE and found.light.complete
    planned = found.planned.proof.scores
    assert found.least.scores.window == pytest.approx(planned.window, abs=1e-3) == found.most.scores.window
    assert found.most is found.least, "no light is in doubt"
    capsys.readouterr()
    assert main(["prove", str(tmp_path / "run"), "--device", "cpu"]) == 0
    told = capsys.readouterr().out
    assert "complete: all 36 frames have their light" in told and (tmp_path / "run.html").is_file()


def test_a_held_print_has_a_status_of_its_own_and_is_proved_by_what_it_showed(
    part: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    opened_door(monkeypatch, None)
    run = tmp_path / "run"
    assert printed(part, run) == 4
    assert "start it again" in (told := capsys.readouterr().out) and "--resume" not in told
    assert read_run(run).state is PrintState.HELD
    (found,) = prove_run(run, "cpu")
    short = found.light.short[0]
    assert 8 < short.sum() < 30 and not found.light.complete and "frames are underexposed" in str(found.light)
    assert found.most.scores.iou < found.planned.proof.scores.iou, "views are missing"
    dose = [proof.dose.numpy().sum() for proof in (found.least, found.most, found.planned.proof)]
    assert dose[0] <= dose[1] < 0.9 * dose[2]
    with pytest.raises(BadInput, match="the job"):
        other = part.rename(part.with_name("other.vam"))
        try:
            (other / "manifest.json").write_text((other / "manifest.json").read_text() + " ")
            prove_run(run, "cpu", other)
        finally:
            text = (other / "manifest.json").read_text()
            (other / "manifest.json").write_text(text[:-1])
            other.rename(part)


def test_jobs_that_were_moved_are_found_by_what_they_hold(tmp_path: Path) -> None:
    jobs = [tmp_path / name for name in ("one.vam", "two.vam")]
    for job in jobs:
        job.mkdir()
        (job / "manifest.json").write_text(job.name)
    asked = {"jobs": [str(tmp_path / "gone" / job.name) for job in jobs], "digests": [digest(job) for job in jobs]}
    path = tmp_path / "part.run"
    run = RunRecord(path, asked, PrintState.COMPLETE, "", np.empty(0), (), 0)
    assert jobs_of(run, ()) == jobs, "beside the run, with which they were moved"
    moved = [job.rename(tmp_path / f"new-{job.name}") for job in jobs]
    assert jobs_of(run, moved[::-1]) == moved
    with pytest.raises(StorageError, match=r"is missing.*--job"):
        jobs_of(run, ())
    with pytest.raises(StorageError, match="one.vam.*is missing"):
        jobs_of(run, moved[1:])
    (other := tmp_path / "other.vam").mkdir()
    for given in ([other], [*moved, other]):
        with pytest.raises(BadInput, match=r"the job .*other.vam"):
            jobs_of(run, given)


@pytest.mark.slow
def test_a_record_that_is_no_record_is_told(part: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    assert printed(part, run) == 0
    told = json.loads((run / "run.json").read_text())
    for wrong in ({"views": "x"}, {"jobs": told["jobs"] * 2}, {"digests": None}):
        (run / "run.json").write_text(json.dumps(told | wrong))
        with pytest.raises(StorageError, match="malformed"):
            prove_run(run, "cpu")
    (run / "state.json").unlink()
    with pytest.raises(StorageError, match=r"has no state.json"):
        prove_run(run, "cpu")


@pytest.mark.parametrize(("state", "status"), [("complete", 0), ("error", 1), ("incomplete", 3), ("held", 4)])
def test_the_status_of_a_command_tells_how_its_print_ended(state: str, status: int) -> None:
    assert status_of(PrintState(state)) == status


def test_an_error_leaves_a_print_held_or_is_raised(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    board, error = Board(), DeviceError("the process is gone")
    with pytest.raises(DeviceError, match="is gone"):
        left(error, board, tmp_path / "run")
    board.show(state=PrintState.HELD)
    assert left(error, board, tmp_path / "run") is PrintState.HELD
    assert capsys.readouterr().err == "held: the process is gone\n"


def test_a_run_has_the_first_free_folder_and_a_chosen_one_must_be_free(tmp_path: Path) -> None:
    for name in ("part.run", "part-2.run", "part.dry-run"):
        assert place_of(None, str(tmp_path / "part.vam"), name.endswith(".dry-run")) == tmp_path / name
        (tmp_path / name).mkdir()
    assert place_of(None, str(tmp_path / "part.vam"), False).name == "part-3.run"
    with pytest.raises(StorageError, match=r"part\.run' exists; a run needs a new folder: choose another with --out"):
        place_of(tmp_path / "part.run", str(tmp_path / "part.vam"), False)


def test_a_job_file_is_not_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for words in ([], ["--live"]):
        assert main(["print", str(tmp_path / "part.toml"), "--rig", "emulated", *words]) == 1
        said = capsys.readouterr().err
        assert "is a job file" in said and f"vam print {tmp_path / 'part.vam'}" in said


def test_names_with_a_dot_have_runs_of_their_own() -> None:
    places = [str(place_of(None, job, False)) for job in ("a/part-0.1", "part-0.2", "part.vam", "slices.zip", "demo")]
    assert places == ["a/part-0.1.run", "part-0.2.run", "part.run", "slices.run", "vamgpu-demo.run"]


@pytest.mark.slow
def test_an_unattended_print_goes_on_and_tells_the_view_in_doubt(
    part: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened_door(monkeypatch, 2.0)
    run = tmp_path / "run"
    assert printed(part, run, "--unattended", "9") == 3
    record = read_run(run)
    assert record.state is PrintState.INCOMPLETE and sum(event["event"] == "segment" for event in record.events) > 1
    (found,) = prove_run(run, "cpu")
    assert found.light.short.sum() == 1 == np.count_nonzero(found.light.unsure), "the frame on show at the fault"
    assert found.least is not found.most and found.least.scores.window <= found.most.scores.window

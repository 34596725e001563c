"""The progress of a run in a file that any process can read."""

from __future__ import annotations

import json
import os
import warnings
from pathlib import Path
from threading import Thread

import numpy as np
import pytest

from vamgpu.cli import main
from vamgpu.errors import BadInput, Cancelled
from vamgpu.jobs import progress as module
from vamgpu.jobs.progress import RunEvents, RunProgress, events_path, recorded, slice_path
from vamgpu.methods.plan import Step
from vamgpu.storage.numpy_files import map_npy


def test_stages_steps_and_the_end_are_read_while_they_are_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "PERIOD", 0.0)
    reader = RunProgress(tmp_path / "boat.vam")
    assert not reader.read() and not reader.running
    with recorded(tmp_path / "boat.vam", "solve") as events:
        events.share("voxels", "voxelizing", 0.0)
        events.share("light", "optimizing", 0.0)
        assert reader.read() and reader.stage == "light" and reader.running and reader.status is None
        assert [stage["stage"] for stage in reader.stages] == ["voxels"] and reader.left is None
        events.step(Step(3, 4.5, float("inf"), 0.25))
        events.share("light", "optimizing", 0.5)
        events.say("note", text="NaN is a word")
        warnings.warn("careful", stacklevel=1)
        assert reader.read() and reader.share == 0.5 and reader.left is not None and reader.left > 0.0
        assert reader.steps == [{"iteration": 3, "evaluations": 4.5, "loss": None, "window": 0.25}]
        assert not reader.read()
    assert reader.read() and not reader.running and (reader.status, reader.message) == (0, "")
    assert reader.notes == ["NaN is a word"] and reader.warnings == ["careful"] and len(reader.stages) == 2


@pytest.mark.parametrize("stage", ["light", "pack"])
def test_the_last_step_of_a_short_run_is_recorded(stage: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "PERIOD", 1e9)
    reader = RunProgress(tmp_path / "boat.vam")
    with recorded(tmp_path / "boat.vam", "solve") as events:
        events.share("light", "optimizing", 0.0)
        for number in (1, 2):
            events.step(Step(number, 1.5, 0.1, 0.25))
            events.share("light", "optimizing", 0.25 * number)
        events.share(stage, "packing", 0.5)
    assert reader.read() and [each["iteration"] for each in reader.steps] == [2]


@pytest.mark.parametrize(
    ("error", "status", "said"), [(BadInput("no"), 1, "no"), (Cancelled("stopped"), 130, "stopped"),
                                  (KeyboardInterrupt(), 130, "KeyboardInterrupt")]
)  # fmt: skip
def test_errors_end_a_run_with_their_message(tmp_path: Path, error: BaseException, status: int, said: str) -> None:
    with pytest.raises(type(error)), recorded(tmp_path / "a", "prove") as events:
        events.share("voxels", "voxelizing", 0.0)
        raise error
    reader = RunProgress(tmp_path / "a")
    reader.read()
    assert (reader.status, reader.message) == (status, said)
    with pytest.raises(type(error)), recorded(tmp_path / "b", "prove"):
        raise error
    assert [file.name for file in tmp_path.iterdir()] == [".a.events.jsonl"], "nothing had begun"


def test_a_second_run_in_the_same_place_starts_anew_and_torn_lines_wait(tmp_path: Path) -> None:
    place, reader = tmp_path / "a", RunProgress(tmp_path / "a")
    with recorded(place, "solve") as events:
        events.say("note", text="first")
    reader.read()
    with recorded(place, "solve") as events:
        events.say("note", text="second")
        with events_path(place).open("ab") as file:
            file.write(b'{"event": "note", "wall": 1, "te')
        reader.read()
        assert reader.notes == ["second"]
        with events_path(place).open("ab") as file:
            file.write(b'xt": "third"}\n[1]\n{"event": "share", "wall": "x"}\n')
        reader.read()
        assert reader.notes == ["second", "third"]


def test_a_second_run_at_the_same_time_leaves_the_first_its_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "TRIES", 1)
    place, reader = tmp_path / "a", RunProgress(tmp_path / "a")
    with recorded(place, "solve") as first:
        first.say("note", text="first")
        with recorded(place, "solve") as second:
            second.say("note", text="second")
        first.say("note", text="still first")
        reader.read()
        assert reader.running and reader.notes == ["first", "still first"]


def test_lines_of_many_threads_stay_whole(tmp_path: Path) -> None:
    events = RunEvents(tmp_path / "a")
    threads = [Thread(target=lambda: [events.say("note", text="x" * 3000) for _ in range(100)]) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    events.close()
    assert [json.loads(line)["event"] for line in events_path(tmp_path / "a").open()] == ["note"] * 400


def test_a_line_that_a_full_disk_cut_does_not_spoil_the_next(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    events, write = RunEvents(tmp_path / "a"), os.write
    monkeypatch.setattr(module.os, "write", lambda file, data: write(file, data[:10]))
    events.say("note", text="cut")
    monkeypatch.undo()
    events.say("note", text="whole")
    events.say("note", text="next")
    events.close()
    assert len(events_path(tmp_path / "a").read_bytes().splitlines()) == 3
    reader = RunProgress(tmp_path / "a")
    assert reader.read() and reader.notes == ["whole", "next"]


def test_a_place_without_locks_records_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(_: int) -> bool:
        raise OSError("no locks available")

    monkeypatch.setattr(module, "locked", refused)
    RunEvents(tmp_path / "a").say("note", text="of a run that nobody can tell from another")
    assert events_path(tmp_path / "a").read_bytes() == b""


def test_keys_and_verdict_of_a_run_are_read(tmp_path: Path) -> None:
    with recorded(tmp_path / "a", "prove", job={"web": {"length": "6 mm"}}) as events:
        events.verdict(False, "2 of 9 voxels print incorrectly.")
    reader = RunProgress(tmp_path / "a")
    assert reader.read() and reader.job == {"web": {"length": "6 mm"}}
    assert reader.verdict == {"prints": False, "sentence": "2 of 9 voxels print incorrectly."}


def test_slices_are_stored_now_and_then(tmp_path: Path) -> None:
    events, made = RunEvents(tmp_path / "a", slices=True), []

    def slice_() -> tuple[np.ndarray, np.ndarray]:
        made.append(1)
        return np.full((2, 3), 0.5), np.ones((2, 3))

    assert events.look is not None and RunEvents(tmp_path / "b").look is None
    for _ in range(50):
        events.look(slice_)
    events.close()
    assert made == [1]
    np.testing.assert_array_equal(map_npy(slice_path(tmp_path / "a"))[:, 0, 0], [0.5, 1.0])


@pytest.mark.slow
def test_the_commands_record_solve_and_keep_the_proof(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from studio_client import BOAT

    monkeypatch.chdir(tmp_path)
    coarse = BOAT.replace("250 um", "500 um").replace("angles = 40", "angles = 20").replace("= 12\n", "= 6\n")
    Path("boat.toml").write_text(coarse, encoding="utf-8")
    assert main(["solve", "boat.toml", "--slices"]) == 0
    run = RunProgress(tmp_path / "boat.vam")
    run.read()
    assert [stage["stage"] for stage in run.stages] == ["voxels", "rays", "light", "frames", "folder", "verdict"]
    assert run.status == 0 and run.slices >= 1 and run.steps[-1]["iteration"] == 6 and run.verdict is not None
    assert main(["prove", "boat.vam", "--save", "boat.proof"]) == 0
    usual = json.loads(Path("boat.proof/manifest.json").read_text())["details"]
    assert usual["judged"]["verdict"]["prints"] in (True, False) and len(usual["judged"]["lines"]) > 10
    assert main(["prove", "boat.vam", "--save", "off.proof", "--off", "dose=-20 %", "--report", "off.html"]) == 0
    off = json.loads(Path("off.proof/manifest.json").read_text())["details"]["proof"]["scores"]
    least = usual["proof"]["scores"]
    assert off["threshold"] == pytest.approx(least["threshold"] / 0.8) and off["peak"] == least["peak"]
    assert off["missing"] > least["missing"]
    assert main(["prove", "boat.vam", "--save", "dim.proof", "--off", "dose=-20 %"]) == 0
    assert Path("off.html").is_file() and not any(Path().glob("dim*.html")) and not Path("boat.off.html").exists()
    assert main(["prove", "boat.vam", "--off", "tilt=1 deg"]) == 1

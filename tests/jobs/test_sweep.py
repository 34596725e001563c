"""Sweeps: every combination, what is done is not done again, and a cluster whose workers die finds the same bytes."""

from __future__ import annotations

import csv
import os
import random
import signal
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from vamgpu.cli import main
from vamgpu.errors import BadInput, DeviceError, JobError
from vamgpu.jobs import cluster, run
from vamgpu.jobs.demo import JOB
from vamgpu.jobs.sweep import Point, sweep, values_of
from vamgpu.storage.folder import Folder

SMALL = ["target.pitch=1 mm", "beam.pitch=1 mm", "beam.pixels=[18, 14]", "turntable.angles=12", "solve.device=cpu"]


@pytest.fixture
def job(tmp_path: Path) -> Path:
    file = tmp_path / "boat.toml"
    file.write_text(JOB)
    return file


@pytest.mark.slow
def test_every_combination_is_solved_and_proven_once(
    job: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[tuple[int, int]] = []
    vary = {"solve.iterations": [2, 3], "vial.absorption": ["0.01 /mm", "-1 /mm"]}
    place = tmp_path / "out"
    points = sweep(job, vary, place, settings=SMALL, progress=lambda point, count: told.append((point.number, count)))
    assert told == [(1, 4), (2, 4), (3, 4), (4, 4)]
    assert [dict(point.values)["solve.iterations"] for point in points] == ["2", "2", "3", "3"]
    for point in points[::2]:
        assert point.window == run.prove(point.folder, "cpu").proof.scores.window and not point.error
        assert Folder.open(point.folder).manifest.inputs["job"]["vial"]["absorption"] == "0.01 /mm"
    assert all("absorption" in point.error and not point.folder.exists() for point in points[1::2])
    with open(place / "sweep.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["window"]) for row in rows[::2]] == [point.window for point in points[::2]]
    assert rows[1]["error"] and rows[0]["folder"] == "0001.vam"

    stamps = [point.folder.stat().st_mtime_ns for point in points[::2]]
    with monkeypatch.context() as unsolved:
        unsolved.setattr(run, "optimize", None)
        again = sweep(job, vary, place, settings=SMALL)
    assert [point.window for point in again[::2]] == [point.window for point in points[::2]]
    assert [point.folder.stat().st_mtime_ns for point in points[::2]] == stamps
    changed = sweep(job, {**vary, "solve.iterations": [4, 3]}, place, settings=SMALL)
    assert changed[0].folder.stat().st_mtime_ns != stamps[0]


def test_values_are_read_and_mistakes_told(job: Path, tmp_path: Path) -> None:
    assert values_of("a.b=1, 2,3") == ("a.b", ["1", "2", "3"])
    assert values_of('a="x, y","z"') == ("a", ['"x, y"', '"z"'])
    assert values_of("a=[1, 2],[3, 4]") == ("a", ["[1, 2]", "[3, 4]"])
    for wrong in ("a", "=1", "a=", "a=1,", "a=,"):
        with pytest.raises(BadInput, match="expected a key and its values"):
            values_of(wrong)
    with pytest.raises(BadInput, match="0 combinations"):
        sweep(job, {}, tmp_path / "out")
    with pytest.raises(BadInput, match="1000000 combinations"):
        sweep(job, {"a": range(1000), "b": range(1000)}, tmp_path / "out")
    with pytest.raises(JobError):
        sweep(tmp_path / "none.toml", {"solve.iterations": [1]}, tmp_path / "out")
    for wrong in ("4", "local:0", "local:", "http://here"):
        with pytest.raises(BadInput, match="expected local:4"):
            sweep(job, {"solve.iterations": [1]}, tmp_path / "out", cluster=wrong)


@pytest.mark.slow
def test_the_command_shows_a_table(job: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    given = [word for setting in SMALL for word in ("--set", setting)]
    assert not main(["sweep", str(job), "--vary", "solve.iterations=1,2", *given])
    assert "solve.iterations" in capsys.readouterr().out
    assert (tmp_path / "boat-sweep" / "0002.vam").is_dir()
    assert main(["sweep", str(job), "--vary", "solve.iterations=1", "--vary", "solve.iterations=2", *given])
    assert "varies twice" in capsys.readouterr().err


class Stranger:
    """A client whose worker is not like this process."""

    def __init__(self, version: str, complaint: str) -> None:
        self.said = {"tcp://there:1": (version, complaint)}

    def wait_for_workers(self, count: int, timeout: float) -> None:
        """It is there."""

    def run(self, function: Any, device: str | None) -> dict[str, tuple[str, str]]:
        return self.said


def test_workers_that_are_not_alike_are_refused() -> None:
    from vamgpu import __version__

    assert cluster.about("numpy") == (__version__, "")
    assert "no device 'nothing'" in cluster.about("nothing")[1]
    cluster._refuse_unlike(Stranger(__version__, ""), None)
    with pytest.raises(DeviceError, match=r"there:1 has vamgpu 0\.0\.1.*install the same"):
        cluster._refuse_unlike(Stranger("0.0.1", ""), None)
    with pytest.raises(DeviceError, match="there:1 cannot compute: no device"):
        cluster._refuse_unlike(Stranger(__version__, "no device 'x'"), "x")


@pytest.mark.slow
def test_a_cluster_that_is_not_there_is_told(job: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "PATIENCE", 1.0)
    with pytest.raises(DeviceError, match="no cluster answers at 'tcp://127.0.0.1:9'"):
        sweep(job, {"solve.iterations": [1]}, tmp_path / "out", cluster="tcp://127.0.0.1:9")


KILLS = 4


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_killed_workers_cost_their_task_and_nothing_else(
    job: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Processes are killed while they work; every folder has the bytes that one process alone gives it."""
    vary = {"solve.iterations": list(range(20, 28))}
    alone = sweep(job, vary, tmp_path / "alone", settings=SMALL)
    pids: list[set[int]] = []
    refuse = cluster._refuse_unlike

    def looked(client: Any, device: str | None) -> None:
        refuse(client, device)
        threading.Thread(target=kill, args=(client,), daemon=True).start()

    def kill(client: Any) -> None:
        chance = random.Random(1)
        while len(pids) < KILLS:
            time.sleep(chance.uniform(0.2, 1.0))
            working = {nanny.pid for nanny in client.cluster.workers.values() if nanny.pid}
            if working:
                pids.append(working)
                os.kill(chance.choice(sorted(working)), signal.SIGKILL)

    monkeypatch.setattr(cluster, "_refuse_unlike", looked)
    done: list[Point] = []
    shared = sweep(job, vary, tmp_path / "shared", settings=SMALL, cluster="local:2",
                   progress=lambda point, count: done.append(point))  # fmt: skip
    assert len(pids) == KILLS and len(done) == len(alone)
    assert len(set().union(*pids)) > 2  # dead ones were replaced
    for one, other in zip(alone, shared, strict=True):
        assert not other.error and one.window == other.window
        hashes = [{n: a.sha256 for n, a in Folder.open(p.folder).manifest.arrays.items()} for p in (one, other)]
        assert hashes[0] == hashes[1]

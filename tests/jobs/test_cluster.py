"""Jobs on a cluster of processes: the bytes of one process alone, whoever is killed."""

from __future__ import annotations

import os
import random
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vamgpu.backend import open_device
from vamgpu.backend.device import Device
from vamgpu.errors import Cancelled, ClusterWarning, DeviceError, WorkerLost
from vamgpu.jobs import cluster, run
from vamgpu.jobs.demo import JOB, WEB_JOB
from vamgpu.jobs.read import Job
from vamgpu.jobs.run import solve
from vamgpu.jobs.web import WebJob, solve_web
from vamgpu.storage.folder import Folder
from vamgpu.webs.store import WebFolder

WEB = [
    "web.length=180 mm", "beam.pitch=400 um", "beam.height=1.2 mm", "roller.step=3 deg", "solve.iterations=4",
    "solve.core=0.5", "solve.overlap=0.5", "solve.device=numpy",
]  # fmt: skip


@contextmanager
def killing(monkeypatch: pytest.MonkeyPatch, kills: int, pause: tuple[float, float]) -> Iterator[list[set[int]]]:
    """Kill processes of a local cluster at random moments; what was alive each time."""
    alive: list[set[int]] = []
    refuse, over = cluster._refuse_unlike, threading.Event()

    def kill(client: Any) -> None:
        chance = random.Random(1)
        while len(alive) < kills and not over.wait(chance.uniform(*pause)):
            working = {nanny.pid for nanny in client.cluster.workers.values() if nanny.pid}
            if working:
                alive.append(working)
                os.kill(chance.choice(sorted(working)), signal.SIGKILL)

    def looked(client: Any, device: str | None) -> None:
        refuse(client, device)
        threading.Thread(target=kill, args=(client,), daemon=True).start()

    monkeypatch.setattr(cluster, "_refuse_unlike", looked)
    try:
        yield alive
    finally:
        over.set()


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_segments_of_a_web_are_those_of_one_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    job, told = WebJob.parse(WEB_JOB, WEB), list[float]()
    alone = solve_web(job, tmp_path / "alone")
    with killing(monkeypatch, 8, (0.1, 0.6)) as alive:
        shared = solve_web(job, tmp_path / "shared", cluster="local:2", progress=lambda _, share: told.append(share))
    assert len(alone.segments) > 6 and shared.complete
    assert [one.sha256 for one in shared.segments] == [one.sha256 for one in alone.segments]
    assert shared.details == alone.details
    assert told == sorted(told) and told[-1] == 1.0
    assert len(alive) >= 3 and len(set().union(*alive)) > 2  # dead ones were replaced
    shared.verify()


@pytest.mark.slow
def test_a_web_goes_on_with_what_a_cluster_left(tmp_path: Path) -> None:
    job = WebJob.parse(WEB_JOB, WEB)
    alone = solve_web(job, tmp_path / "alone")

    def stop(_: str, share: float) -> None:
        if share > 0.3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        solve_web(job, tmp_path / "web", cluster="local:2", progress=stop)
    begun = len(WebFolder.open(tmp_path / "web").segments)
    assert 0 < begun < len(alone.segments)
    found = solve_web(job, tmp_path / "web", cluster="local:2")
    assert [one.sha256 for one in found.segments] == [one.sha256 for one in alone.segments]


VIAL = ["target.pitch=1 mm", "beam.pitch=1 mm", "beam.pixels=[18, 14]", "turntable.angles=12", "solve.device=numpy"]
"""A job of some seconds."""


def light_of(path: Path) -> np.ndarray:
    return Folder.open(path).array("frames")


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_slabs_on_workers_find_the_light_of_one_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """To rounding that of one device, and bit by bit that of a cluster where nobody was killed."""
    job = Job.parse(JOB, [*VIAL, "solve.iterations=5"])
    alone = light_of(solve(job, tmp_path / "alone").path)
    shared = solve(Job.parse(JOB, [*VIAL[:-1], "solve.iterations=1"]), tmp_path / "best", cluster="local:2")
    assert shared.manifest.device.startswith(f"{open_device(None).name} on local:2 ")
    whole = light_of(solve(job, tmp_path / "whole", cluster="local:2").path)
    np.testing.assert_allclose(whole, alone, rtol=1e-6, atol=1e-6 * alone.max())
    monkeypatch.setattr(run, "CHECKPOINT", 1.0)
    with killing(monkeypatch, 2, (3.0, 6.0)) as alive, pytest.warns(ClusterWarning, match="lost.*saved last"):
        found = light_of(solve(job, tmp_path / "killed", cluster="local:2").path)
    assert len(alive) >= 2 and len(set().union(*alive)) > 2
    np.testing.assert_array_equal(found, whole)
    assert not run.is_interrupted(tmp_path / "killed")


@pytest.mark.timeout(300)
@pytest.mark.slow
def test_a_job_that_is_replaced_is_solved_anew_whoever_is_lost(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Plans are kept beside what stands at the place, which stays until the new job is whole."""
    begun = list[bool]()

    @contextmanager
    def slabs(*_: Any) -> Iterator[Any]:
        def made() -> Device:
            begun.append(bool(sum(one.is_dir() for one in tmp_path.glob(".boat-*/boat"))))
            if len(begun) == 3:
                raise WorkerLost("the worker is gone")
            return open_device("cpu")

        yield made

    quick = [*VIAL[:-1], "solve.device=cpu"]
    other, job = (Job.parse(JOB, [*quick, f"solve.iterations={count}"]) for count in (2, 5))
    alone = light_of(solve(job, tmp_path / "alone").path)
    standing = light_of(solve(other, tmp_path / "boat").path)
    monkeypatch.setattr(run, "slabs", slabs)
    monkeypatch.setattr(run, "CHECKPOINT", 0.0)
    monkeypatch.setattr(run, "RARELY", 0.0)
    with pytest.warns(ClusterWarning, match="saved last"):
        found = light_of(solve(job, tmp_path / "boat", overwrite=True, cluster="local:1").path)
    assert not np.array_equal(standing, alone) and np.array_equal(found, alone)
    assert begun[:2] == [False, True] and all(begun[1:]) and len(begun) > 3
    assert sorted(path.name for path in tmp_path.iterdir()) == ["alone", "boat"]


@pytest.mark.slow
def test_ctrl_c_in_a_terminal_reaches_workers_too_and_leaves_the_plan(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    refuse, working = cluster._refuse_unlike, list[int]()

    def looked(client: Any, device: str | None) -> None:
        refuse(client, device)
        working.extend(nanny.pid for nanny in client.cluster.workers.values())

    def stop(stage: str, share: float) -> None:
        if stage == "light" and share >= 0.1:
            for process in (*working, os.getpid()):
                os.kill(process, signal.SIGINT)
            time.sleep(1.0)  # in which it comes

    monkeypatch.setattr(cluster, "_refuse_unlike", looked)
    job = Job.parse(JOB, [*VIAL, "solve.iterations=30"])
    with pytest.raises(Cancelled) as stopped:
        solve(job, tmp_path / "boat", cluster="local:2", progress=stop)
    assert len(working) == 2 and stopped.value.plan is not None and run.is_interrupted(tmp_path / "boat")


class Deserted:
    """The client of a scheduler whose workers are gone for good."""

    status = "running"

    def nthreads(self) -> dict[str, int]:
        return {}

    def wait_for_workers(self, count: int, timeout: float) -> None:
        raise TimeoutError(f"{count} of 0 workers")


def test_a_cluster_without_workers_ends_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "PATIENCE", 0.2)
    monkeypatch.setattr(cluster, "RETURN", 0.0)
    with pytest.raises(DeviceError, match="no worker is left; start some") as told:
        cluster._remote(Deserted(), None, 0, 4)
    assert not isinstance(told.value, WorkerLost)  # which a run would go on after


def test_a_worker_takes_one_device(tmp_path: Path) -> None:
    job = Job.parse(JOB, [*VIAL, "solve.device=numpy+numpy"])
    with pytest.raises(DeviceError, match="several devices, for a worker; expected one"):
        solve(job, tmp_path / "boat", cluster="local:1")


@pytest.mark.slow
def test_a_task_that_fails_is_told_at_once(tmp_path: Path) -> None:
    """Only what a dead worker was at is begun anew."""
    calls = tmp_path / "calls"

    def fails(_: int) -> None:
        with calls.open("a", encoding="utf-8") as file:
            file.write("x")
        raise ValueError("wrong in itself")

    with cluster.workers("local:1", "numpy") as each, pytest.raises(ValueError, match="wrong in itself"):
        list(each(fails, [1]))
    assert calls.read_text(encoding="utf-8") == "x"


@pytest.mark.parametrize("name", ["warp:cuda:1", "OpenCL:nvidia:10", "nvidia:2"])
def test_local_workers_have_no_gpu_of_another_number(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "1,3")
    monkeypatch.setattr(cluster, "_client", lambda where: pytest.fail(f"began {where}"))
    with pytest.raises(DeviceError, match="one GPU each, number 0"), cluster.workers("local:2", name):
        pass
    for where, other in (("tcp://host:8786", name), ("local:2", "warp:cuda:0"), ("local:2", "opencl:pocl:1")):
        with pytest.raises(pytest.fail.Exception, match="began"), cluster.slabs(where, other):
            pass
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "")
    with pytest.raises(pytest.fail.Exception, match="began"), cluster.slabs("local:2", name):
        pass


def seen(_: int) -> tuple[int, str | None]:
    time.sleep(0.2)  # until the other worker takes one, too
    return os.getpid(), os.environ.get("CUDA_VISIBLE_DEVICES")


@pytest.mark.slow
def test_local_workers_take_the_gpus_in_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "3, GPU-a5")
    with cluster.workers("local:3", "numpy") as each:
        found = dict(each(seen, range(12)))
    assert sorted(str(gpu) for gpu in found.values()) == ["3", "3", "GPU-a5"]
    monkeypatch.delenv("CUDA_VISIBLE_DEVICES")
    monkeypatch.setattr(cluster, "GPUS", os.fspath(Path(__file__).parent / "nowhere"))
    assert cluster._visible_gpus() == []

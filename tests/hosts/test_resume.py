"""Prints that a host left, gone on with by another on the rig's own terms."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vamgpu.cli import main
from vamgpu.errors import BadInput, TimingInfeasible
from vamgpu.hosts.players.triggered import PREROLL
from vamgpu.hosts.record import RunFolder, read_run
from vamgpu.hosts.rig import Plan, Rehearsal, carry_out, check, limits, may_go_on, plan, player, rehearsal
from vamgpu.hosts.rigs.config import EMULATED, parse_rig
from vamgpu.hosts.rigs.runs import asked_for, left_by_a_host
from vamgpu.hosts.run import Print
from vamgpu.hosts.schedules.timing import SECOND
from vamgpu.hosts.state import State
from vamgpu.printing.folder import save_frames
from vamgpu.printing.frames import Frames
from vamgpu.printing.gray import GrayCurve

LAB = """
[rig]
name = "bench"
machine = "vial"
[controller]
driver = "vam-controller"
port = "/dev/does-not-exist"
[projector]
driver = "alp"
library = "/does/not/exist.so"
"""


@pytest.fixture
def job(tmp_path: Path) -> Path:
    images = np.random.default_rng(4).integers(0, 256, (36, 6, 10), dtype=np.uint8)
    frames = Frames.from_bytes(images, "numpy", bits=8, gray=GrayCurve.linear(), scale=1.0, columns=10)
    return save_frames(tmp_path / "part.vam", frames).path


def planned(job: Path, *settings: str) -> Plan:
    return plan(job, parse_rig(EMULATED, settings, source="emulated"), speed=40.0)


def begun(wanted: Plan, path: Path, pictures: int) -> tuple[Rehearsal, Print]:
    """A print that has shown some pictures and more, held by its host."""
    stand = rehearsal(wanted)
    job = Print(
        player(wanted, stand.machines), RunFolder.begin(path, asked_for(wanted), wanted.rig.text),
        limits=limits(wanted.rig),
    )  # fmt: skip
    job.guard.__enter__()
    job.begin(0)
    while job.next < pictures:
        job.player.wait()
        assert job.step()
    return stand, job


def until(stand: Rehearsal, job: Print, pictures: int) -> None:
    """The leg goes on, and nobody looks at it."""
    while stand.bench.controller.shown < pictures:
        job.lease.beat()
        job.lease.keep(force=True)
        stand.bench.clock.sleep(SECOND // 100)


def gone(stand: Rehearsal, job: Print) -> None:
    """The host dies; its lease runs out."""
    job.guard._release_process()
    job.folder.close()
    stand.bench.clock.sleep(SECOND)
    assert not stand.bench.controller.light
    stand.bench.alps[0].forsake()


def died(wanted: Plan, path: Path) -> tuple[Rehearsal, Any]:
    """A print whose host is gone in the midst, and the machines as the next host opens them."""
    stand, job = begun(wanted, path, 12)
    gone(stand, job)
    return stand, again(stand, wanted)


def again(stand: Rehearsal, wanted: Plan) -> Any:
    """The machines, as another host opens them."""
    return stand.bench.machines(stand.bench.microsteps / float(wanted.schedule.advance))


def test_a_print_goes_on_and_all_its_light_is_counted(job: Path, tmp_path: Path) -> None:
    wanted = planned(job, "light.power=0.5")
    stand, machines = died(wanted, tmp_path / "run")
    before = len(read_run(tmp_path / "run").shown)
    state, again = carry_out(wanted, machines, tmp_path / "run", resume=True)
    run, budget = read_run(tmp_path / "run"), again.guard.budget
    assert state is State.COMPLETE and run.shown["slot"].tolist() == list(range(36)) and before < 36
    assert budget is not None and budget.spent == pytest.approx(0.5e-9 * run.shown["on_time"].sum())
    assert run.asked["settings"] == ["light.power=0.5"] and stand.witness.verdict().pictures == 36


@pytest.mark.parametrize(
    ("settings", "told"),
    [(("light.power=0.6",), r"\[light\]"), (("light.power=0.5", "controller.microsteps=1600.0"), r"\[controller\]")],
)
def test_another_light_or_motion_is_refused(job: Path, tmp_path: Path, settings: tuple[str, ...], told: str) -> None:
    _, machines = died(planned(job, "light.power=0.5"), tmp_path / "run")
    with pytest.raises(BadInput, match=told):
        carry_out(planned(job, *settings), machines, tmp_path / "run", resume=True)


def test_what_leaves_the_light_as_it_is_may_change(job: Path, tmp_path: Path) -> None:
    _, machines = died(planned(job), tmp_path / "run")
    calmer = planned(job, "safety.resume=20 s", "camera.exposure=4 ms")
    assert carry_out(calmer, machines, tmp_path / "run", resume=True)[0] is State.COMPLETE


def test_a_refusal_forgets_nothing(job: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whether machines were opened for it or not; the print still goes on."""
    path = tmp_path / "run"
    stand, _ = died(planned(job, "light.power=0.5"), path)
    shown = stand.bench.controller.shown
    with pytest.raises(BadInput, match=r"\[light\].*--set 'light.power=0.5'"):
        may_go_on(planned(job), path)
    with pytest.raises(BadInput, match="speed 40.0 in place of 50.0"):
        may_go_on(plan(job, parse_rig(EMULATED, ("light.power=0.5",), source="emulated"), speed=50.0), path)
    may_go_on(planned(job, "light.power=0.5"), path)
    wanted = planned(job, "light.power=0.5")
    for _ in range(2):
        stand.bench.alps[0].forsake()
        with monkeypatch.context() as patch, pytest.raises(TimingInfeasible, match="too slow"):
            patch.setattr("vamgpu.hosts.rig.judged", too_slow)
            check(wanted, again(stand, wanted))
    assert stand.bench.controller.shown == shown
    stand.bench.alps[0].forsake()
    assert carry_out(wanted, again(stand, wanted), path, resume=True)[0] is State.COMPLETE
    assert read_run(path).shown["slot"].tolist() == list(range(36))


def too_slow(*_: Any, **__: Any) -> None:
    raise TimingInfeasible("the wire is too slow", "upload", 1.0, "deg/s")


def test_a_leg_that_nobody_wrote_down_is_known_after_refusals(job: Path, tmp_path: Path) -> None:
    """The host died before its first look at a leg that was shown in part; the controller is opened twice then."""
    wanted, path = planned(job), tmp_path / "run"
    stand, old = begun(wanted, path, 12)
    old.pause()
    while old.step():
        old.player.wait()
    rested, old._pausing = old.next, False
    old.guard.__exit__(None, None, None)
    old.guard.__enter__()
    old.begin(rested)
    until(stand, old, PREROLL + 3)
    gone(stand, old)
    for _ in range(2):
        found = left_by_a_host(wanted, again(stand, wanted), path)
        assert found.recorded == rested < found.first
        stand.bench.alps[0].forsake()


@pytest.mark.parametrize("black", [0, 1, PREROLL])
def test_a_host_that_died_before_the_first_slot(job: Path, tmp_path: Path, black: int) -> None:
    wanted, path = planned(job), tmp_path / "run"
    stand, old = begun(wanted, path, 0)
    until(stand, old, black)
    gone(stand, old)
    assert stand.bench.controller.shown == black
    state, _ = carry_out(wanted, again(stand, wanted), path, resume=True)
    assert state is State.COMPLETE and read_run(path).shown["slot"].tolist() == list(range(36))


def test_the_command_asks_before_it_opens_machines(
    job: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    carry_out(planned(job), rehearsal(planned(job)).machines, tmp_path / "run")
    opened: list[int] = []
    monkeypatch.setattr("vamgpu.hosts.rig.opened", lambda *_, **__: opened.append(1))
    rig = tmp_path / "lab.toml"
    rig.write_text(LAB)
    assert main(["print", str(job), "--rig", str(rig), "--resume", str(tmp_path / "run")]) == 1
    told = capsys.readouterr().err
    assert "the rig has other values in [controller], [projector]" in told and not opened

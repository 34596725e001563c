"""Prints of parts that move: what emulated machines showed, exposed by this test, and what goes wrong."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh
from scipy.ndimage import gaussian_filter
from test_given_dose import CABLE, PART, STAGE, USUAL

import vamgpu as vam
from vamgpu.cli import main
from vamgpu.errors import BadInput, DeviceRefused, JobError, TimingInfeasible, VamError
from vamgpu.hosts.emulators.dose import MARGIN
from vamgpu.hosts.emulators.rigs import LIFT
from vamgpu.hosts.live.needs import watchable
from vamgpu.hosts.player.height import LEAD
from vamgpu.hosts.player.motor import POLL
from vamgpu.hosts.records.proof import prove_run, shown_frames
from vamgpu.hosts.records.record import read_run
from vamgpu.hosts.records.state import PrintState
from vamgpu.hosts.rig import PrintPlan, carry_out, plan, read_rig, rehearsal
from vamgpu.hosts.rigs.config import parse_rig
from vamgpu.hosts.rigs.connection import close, opened
from vamgpu.hosts.rigs.roles import LightPart
from vamgpu.hosts.rigs.turns import Turning
from vamgpu.hosts.schedules.limits import MirrorTiming
from vamgpu.hosts.schedules.mirrors import turned
from vamgpu.hosts.schedules.schedule import Schedule
from vamgpu.jobs.read import read_job
from vamgpu.jobs.run import prove, solve
from vamgpu.printing.given_dose import ProvedDose
from vamgpu.printing.independent_exposure import IndependentExposure

PITCH, ANGLES, TURNS, PERIOD = 0.1, 24, 3, 12.0
GRID, BEAM = vam.Grid((10, 10, 8), PITCH), vam.Beam((16, 14), PITCH)
FINE = 16  # samples of a mirror
FEW = 12  # angles of prints that fail
LIFTED = """
[lift]
driver = "zaber"
port = "/dev/no-lift"
microsteps = 10000.0
encoder = true
"""
RIGS = {"controller": read_rig("emulated"), "stage": parse_rig(STAGE + LIFTED), "cable": parse_rig(CABLE + LIFTED)}


def sinking(angles: int = ANGLES, period: float | None = PERIOD) -> vam.Travel:
    return vam.Travel(-2.6 * PITCH * np.linspace(0.0, 1.0, TURNS * angles).reshape(TURNS, angles), period=period)


def job(folder: Path, travel: vam.Travel, angles: int = ANGLES) -> tuple[vam.Projection, vam.Frames, Path]:
    """A spot of light beside the axis and off the middle, which differs from angle to angle."""
    A = vam.Projection(GRID, BEAM, vam.Turntable(angles, lit_share=0.98, travel=travel), None, "numpy")
    r, z = np.arange(16) - 7.5, np.arange(14) - 6.5
    aside = 2.0 * np.sin(2 * np.pi * np.arange(angles) / angles)[:, None]
    across, along = np.exp(-(((r - aside) / 4.0) ** 2)), np.exp(-(((z - 1.0) / 2.0) ** 2))
    frames = vam.pack(A, across[:, :, None] * along)
    return A, frames, frames.save(folder / "job.vam")


class Heard:
    """Light of emulated mirrors, by the frame since the first: [row, column] in ns, and the time of its slot [ns]."""

    def __init__(self, planned: PrintPlan) -> None:
        self.planned, self.stand, self.seen = planned, rehearsal(planned), dict[int, tuple[Any, int]]()
        self.stand.emulated.recorder.listeners.append(self.heard)

    def heard(self, light: np.ndarray, begin: int, end: int) -> None:
        if light.any():
            pose, table = self.stand.emulated.recorder.pose, self.planned.schedule
            frame = int(pose((begin + end) // 2))
            slot = begin - round((pose(begin) - frame - MARGIN) * float(table.cadence.period))  # planes may be dark
            self.seen[frame] = self.seen.get(frame, (0.0, 0))[0] + np.array(light, float) * (end - begin), slot

    def dose(self, height: Any) -> np.ndarray:
        """Dose of every voxel, by straight rays. height: of the part [mm], by turns and time [ns]."""
        recorder, (down, across) = (
            self.stand.emulated.recorder,
            self.planned.mirrors[0].place(*self.planned.jobs[0].shape),
        )
        part = (np.arange(5) - 2.0) / 5 * PITCH
        x, y = ((axis[:, None] + part).ravel() for axis in GRID.axes()[:2])
        edges = (np.arange(GRID.shape[2] + 1)[:, None] - 0.5 * GRID.shape[2]) * PITCH
        on, total = int(self.planned.schedule.on[0]), np.zeros((len(x), len(y), GRID.shape[2]))
        for frame, (light, slot) in self.seen.items():
            image = np.kron(light[down, across][::-1], np.ones((FINE, FINE)))
            image = gaussian_filter(image, 0.5 * FINE, mode="constant", truncate=6)  # of a projector in focus
            rims = (np.arange(len(image) + 1) - 0.5 * len(image)) * PITCH / FINE
            for share in (np.arange(5) + 0.5) / 5:
                now = slot + round(share * on)
                turns = (frame + recorder.pose(now) - recorder.pose(slot + on // 2)) / ANGLES
                theta, z = 2 * np.pi * turns, edges + height(turns, now)
                r = np.subtract.outer(-x * np.sin(theta), -y * np.cos(theta))
                column = np.rint(r * FINE / PITCH + 0.5 * (FINE * self.planned.jobs[0].shape[1] - 1)).astype(int)
                lit = np.clip(np.minimum(z[1:], rims[1:]) - np.maximum(z[:-1], rims[:-1]), 0.0, None)
                total += (lit @ image)[:, column].transpose(1, 2, 0)
        return total.reshape(10, 5, 10, 5, 8).mean(axis=(1, 3))


def apart(got: np.ndarray, wanted: np.ndarray) -> float:
    """The greatest difference of two doses of the same energy, relative to the peak."""
    return float(np.abs(got * wanted.sum() / got.sum() - wanted).max() / wanted.max())


def judged(A: vam.Projection, frames: vam.Frames) -> np.ndarray:
    """The dose of a proof."""
    dose = A.device.empty(GRID.shape)
    for _ in IndependentExposure(A).onto(frames.irradiance(A.device), dose):
        pass
    return dose.numpy().astype(float)


@pytest.mark.parametrize("name", RIGS)
def test_machines_show_each_turn_its_frames(name: str, tmp_path: Path) -> None:
    A, frames, folder = job(tmp_path, sinking())
    heard = Heard(plan(folder, RIGS[name], rehearsed=True, exposure=False))
    assert carry_out(heard.planned, heard.stand.machines, tmp_path / "run")[0] is PrintState.COMPLETE
    numbers = read_run(tmp_path / "run").shown["frame"]
    assert numbers.tolist() == list(range(TURNS * ANGLES))
    times, heights = np.arange(TURNS * ANGLES) / ANGLES, np.ravel(sinking().up)
    inside, wanted = GRID.cylinder(), judged(A, frames)[GRID.cylinder()]
    assert apart(heard.dose(lambda turns, now: np.interp(turns, times, heights))[inside], wanted) <= 1e-3
    assert apart(heard.dose(lambda turns, now: 0.0)[inside], wanted) > 0.05


@pytest.mark.parametrize("name", RIGS)
def test_a_lift_raises_the_vial_past_the_image(name: str, tmp_path: Path) -> None:
    """The part is at the heights at which the emulated stage was."""
    path = vam.Travel.helix(ANGLES, 2 * PITCH, height=14 * PITCH, rows=6, pitch=PITCH)
    A, frames, folder = job(tmp_path, path)
    heard = Heard(plan(folder, RIGS[name], rehearsed=True, exposure=False))
    lift, clock = heard.stand.emulated.lift, heard.stand.machines.clock
    lift.track.set_position(0, 5.0 * LIFT)  # where the operator left it
    started, run = list[int](), lift.track.run

    def noted(now: int, speed: float) -> None:
        started.extend([now] * (speed != 0.0))
        run(now, speed)

    lift.track.run = noted
    assert carry_out(heard.planned, heard.stand.machines, tmp_path / "run")[0] is PrintState.COMPLETE
    first, period = min(heard.seen), float(heard.planned.schedule.cadence.period)
    late = started[0] + LEAD - heard.seen[first][1] + first * period
    assert len(started) == 1 and abs(late) <= (0.5 * POLL if name == "cable" else 0.05 * POLL)
    inside, wanted = GRID.cylinder(), judged(A, frames)[GRID.cylinder()]
    assert apart(heard.dose(lambda turns, now: lift.true_position(now) / LIFT - 5.0)[inside], wanted) <= 2e-3
    assert lift.true_position(clock.now()) == pytest.approx(5.0 * LIFT, abs=1.0) and not lift.track.moving(clock.now())


def with_fault(planned: PrintPlan, fault: Any, slot: int) -> Heard:
    """The emulated machines of a print in which a fault happens once a frame was lit."""
    heard, hear, at = Heard(planned), Heard.heard, list[int]()

    def until(*light: Any) -> None:
        hear(heard, *light)
        if len(heard.seen) >= slot and not at:
            at.append(slot)
            fault(heard.stand.emulated)

    heard.stand.emulated.recorder.listeners[:] = [until]
    return heard


@pytest.mark.parametrize(
    ("name", "slot", "fault", "why"),
    [
        ("stage", 40, lambda emulated: emulated.turn(0.0), None),
        (
            "stage",
            8,
            lambda emulated: emulated.turn(0.78 * 2),
            r"the part is at -.* mm, and its frames follow one at -.* mm: check the vial",
        ),
        ("cable", 40, lambda emulated: emulated.turn(0.0), None),
    ],
)
def test_a_vial_that_stops_or_lags_ends_the_print_of_a_part_that_sinks(
    name: str, slot: int, fault: Any, why: str | None, tmp_path: Path
) -> None:
    """The part goes on sinking in the dark, so that the print cannot wait; the frame that was cut is in doubt."""
    heard = with_fault(plan(job(tmp_path, sinking())[2], RIGS[name], rehearsed=True, exposure=False), fault, slot)
    with pytest.raises(VamError, match=why):
        carry_out(heard.planned, heard.stand.machines, tmp_path / "run", unattended=1)
    run = read_run(tmp_path / "run")
    assert run.state is PrintState.ERROR and len(run.shown) < TURNS * ANGLES
    assert run.doubt and run.doubt[-1][1] >= len(run.shown) - 1
    assert why or len(heard.seen) <= slot + 3, "dark within a few frames"


@pytest.mark.parametrize(
    "fault",
    [
        lambda emulated: emulated.lift.track.run(emulated.clock.now(), 0.0),  # stalls
        lambda emulated: emulated.lift.track.run(emulated.clock.now(), 0.5 * 0.2 * 40 / 360 * LIFT),  # half as fast
    ],
)
def test_a_lift_that_stalls_or_lags_holds_the_print_which_then_goes_on(fault: Any, tmp_path: Path) -> None:
    path = vam.Travel.helix(ANGLES, 2 * PITCH, height=14 * PITCH, rows=6, pitch=PITCH)
    planned = plan(job(tmp_path, path)[2], RIGS["controller"], rehearsed=True, exposure=False)
    heard = with_fault(planned, fault, 60)
    state, done = carry_out(planned, heard.stand.machines, tmp_path / "run", unattended=1)
    run = read_run(tmp_path / "run")
    held = [event["error"] for event in run.events if event["event"] == "ended"]
    assert len(held) == 1 and re.search("the part is at .*: check the lift", held[0]), run.events
    assert state is PrintState.INCOMPLETE and done.holds == 1 and run.doubt and len(run.shown) == len(planned.schedule)
    keys = np.array(list(heard.seen))  # the vial turns on in the dark, once or more
    gap = int(np.argmax(np.diff(keys)))
    keys[gap + 1 :] -= round((keys[gap + 1] - keys[gap]) / ANGLES) * ANGLES
    middles = [slot + int(planned.schedule.on[0]) // 2 for _, slot in heard.seen.values()]
    off = np.array([heard.stand.emulated.lift.true_position(at) / LIFT for at in middles]) - np.ravel(path.up)[keys]
    assert keys[gap] - 60 < 40 and np.abs(off).max() <= 0.6 * PITCH and abs(off[-1]) <= 0.02 * PITCH


def test_a_lift_that_ends_too_soon_or_moves_unevenly_is_refused(tmp_path: Path) -> None:
    path = vam.Travel.helix(ANGLES, 2 * PITCH, height=14 * PITCH, rows=6, pitch=PITCH)
    heard = Heard(plan(job(tmp_path, path)[2], RIGS["controller"], rehearsed=True, exposure=False))
    limits = heard.stand.emulated.lift.settings
    for name, end in (("limit.min", np.min(path.up) - 1e-3), ("limit.max", 0.3)):  # it starts before its path
        limits |= {"limit.min": -9 * round(LIFT), name: round(end * LIFT)}
        with pytest.raises(BadInput, match=r"the vial moves from -0.9\d* to 0.8\d* mm, .* goes from -.* to .* mm"):
            carry_out(heard.planned, heard.stand.machines, tmp_path / "run")
    lift = heard.stand.machines.lift
    assert lift is not None
    with pytest.raises(DeviceRefused):
        lift.move(0.4, 1.0)
    uneven = vam.Travel(np.array(path.up) * np.linspace(0.9, 1.0, path.turns)[:, None], rows=6)
    (tmp_path / "uneven").mkdir()
    heard = Heard(plan(job(tmp_path / "uneven", uneven)[2], RIGS["controller"], rehearsed=True, exposure=False))
    with pytest.raises(BadInput, match="rises unevenly"):
        carry_out(heard.planned, heard.stand.machines, tmp_path / "other")
    with pytest.raises(BadInput, match=r"a vial that rises .* the rig .* has no \[lift\]"):
        plan(tmp_path / "job.vam", parse_rig(STAGE), exposure=False)


def test_prints_of_other_turns_or_speeds_and_watched_ones_are_refused(tmp_path: Path) -> None:
    folder = job(tmp_path, sinking())[2]
    given: dict[str, Any]
    for given in ({"turns": 2}, {"speed": 40}):
        with pytest.raises(BadInput, match="expected its 3 turns at 30 deg/s"):
            plan(folder, RIGS["controller"], exposure=False, **given)
    assert plan(folder, RIGS["controller"], turns=3, speed="5 rpm", exposure=False).schedule.turns == 3
    (tmp_path / "odd").mkdir()
    with pytest.raises(TimingInfeasible, match=r'solve the job with period = "9.2\d* s" in \[travel\]'):
        plan(job(tmp_path / "odd", sinking(period=9.1))[2], RIGS["cable"], exposure=False)
    with pytest.raises(JobError, match=r"job: +no, the job is not for a part at rest.*or \[travel\]\n  angles: +yes"):
        watchable(folder, RIGS["controller"], 30.0, real=False, measured=False)


SINKS = """[travel]
turns = {turns}
period = "9 s"
density_difference = "100 kg/m3"
viscosity = "10 Pa s"
diameter = "4 mm"
"""


def solved(folder: Path, path: str, angles: int) -> Path:
    trimesh.creation.cylinder(3.0, 6.0).export(folder / "part.stl")
    file = folder / "part.toml"
    file.write_text(PART.format(**USUAL | {"angles": angles}) + path)
    return solve(read_job(file), file.with_suffix(".vam")).path


@pytest.mark.slow
def test_a_print_gives_the_proved_dose_in_the_turns_of_the_path(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, run = solved(tmp_path, SINKS.format(turns=4), angles=24), tmp_path / "run"
    assert main(["print", str(folder), "--rig", "emulated", "--out", str(run)]) == 0
    told = " ".join(capsys.readouterr().out.split())
    assert "4 turns in 3" in told and told.count("dose 1.000 times the proved dose") == 3 and "report.html" in told
    times, planned = prove(folder).proof.exposure, plan(folder, read_rig("emulated"))
    assert times is not None and times.seconds == 36.0
    lamp, on = 0.65, 1e-9 * int(planned.schedule.on[0])  # mW/mm² of [print], which are dimmed by time
    assert 4 * on * lamp == pytest.approx(times.irradiance * times.seconds / 24, rel=1e-3)
    found = prove_run(run)[0]
    assert np.allclose(found.least.dose.numpy(), found.planned.proof.dose.numpy(), rtol=1e-5)
    sure = found.light.sure.copy()
    sure[0, : 2 * 24] = 0
    half = shown_frames(found.run, replace(found.light, sure=sure), found.planned.proof)
    assert half.share.shape == (24, 1) and np.allclose(half.share, 0.5)


def test_a_helix_turns_slowly_enough_for_its_dose_and_a_part_that_sinks_cannot() -> None:
    """The lamp of 1 mW/mm² takes 90 s of full light; 5 turns at 40 deg/s last 45 s."""
    path = vam.Travel(PITCH * np.linspace(-1.0, 1.0, 5)[:, None], rows=4)
    known = ProvedDose(90.0, 1.0, 1.0, 0.99, 1.01, True)

    def table(speed: float, turns: int) -> Schedule:
        return turned(36, speed=speed, turns=turns, engines=MirrorTiming(dark=0))

    made, dose = Turning(table, 40.0, LightPart(), 1.0, 10**6, (), True, path).schedule(None, lambda: known)
    assert dose is not None and dose.share == pytest.approx(1.0, abs=1e-3) and dose.turns == 5
    assert float(made.speed) == pytest.approx(20.0, rel=1e-3)
    with pytest.raises(BadInput, match="takes 10 turns of 9 s; with 5 turns .* use 2 times the light, or more turns"):
        Turning(table, 40.0, LightPart(), 1.0, 10**6, (), False, path).schedule(None, lambda: known)


@pytest.mark.parametrize("driver", ['driver = "controller"\nmicrosteps = 9.0', 'driver = "stepper"\nmicrosteps = 9.0'])
def test_a_lift_reports_its_height(driver: str) -> None:
    with pytest.raises(JobError, match="lift.*expected a stage that reports its position"):
        parse_rig(CABLE + f"[lift]\n{driver}\n")


def test_a_lift_needs_its_microsteps_per_mm() -> None:
    text = (Path(__file__).parents[2] / "docs" / "rigs" / "epfl.toml").read_text()
    with pytest.raises(JobError, match="lift.*expected its microsteps per mm"):
        parse_rig(text + '[lift]\ndriver = "zaber"\nport = "/dev/ttyUSB7"\n')


def test_a_lift_is_opened_in_mm_and_its_encoder_watches_the_part(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = parse_rig((Path(__file__).parents[2] / "docs" / "rigs" / "epfl.toml").read_text() + LIFTED)
    asked, closed = list[tuple[float, str]](), list[str]()

    def opened_as(port: str, microsteps: float, unit: str, *_: Any, **__: Any) -> Any:
        asked.append((microsteps, unit))
        return SimpleNamespace(unit=unit, close=lambda: closed.append(unit))

    monkeypatch.setattr("vamgpu.hosts.rigs.motions.ZaberStage.open", opened_as)
    monkeypatch.setattr(type(rig.setup.display[0]), "open", lambda self: SimpleNamespace(close=lambda: None))
    machines = opened(rig)
    assert asked[1] == (10000.0, "mm") and machines.lift is not None and machines.lift.unit == "mm"
    close(machines)
    assert sorted(closed) == ["deg", "mm"]
    path = vam.Travel.helix(ANGLES, 2 * PITCH, height=14 * PITCH, rows=6, pitch=PITCH)
    folder = job(tmp_path, path)[2]
    kinds = {
        name: {one.about: one.kind for one in plan(folder, RIGS[name], exposure=False).guarantees} for name in RIGS
    }
    assert {name: kinds[name]["part"] for name in RIGS} == {
        "controller": "believed",
        "stage": "watched",
        "cable": "watched",
    }

"""A vial that is watched on emulated machines: decisions reach the resin, are recorded, and repeat bit by bit."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import vamgpu
from vamgpu.backend import open_device
from vamgpu.cli.print import PrintOptions, print_
from vamgpu.errors import BadInput, JobError, StorageError
from vamgpu.hosts.live import live_print
from vamgpu.hosts.live.live_print import RedCamera
from vamgpu.hosts.live.planner import Following, levels_of, light_of
from vamgpu.hosts.records.record import RunRecord, read_run
from vamgpu.hosts.records.state import Board, PrintState
from vamgpu.hosts.rigs.config import EMULATED, read_rig
from vamgpu.hosts.rigs.rehearsal import resin_of
from vamgpu.jobs.demo import _begun
from vamgpu.jobs.read import Job
from vamgpu.jobs.run import prove, solve
from vamgpu.live import LiveLoop, LiveRecord, Truth
from vamgpu.live.loop import LiveState
from vamgpu.live.record import ENTRY
from vamgpu.live.report import page
from vamgpu.printing.folder import load_frames
from vamgpu.reports import chart

JOB = """
[target]
shape = "nut"
height = "1.6 mm"
pitch = "200 um"
[beam]
pitch = "200 um"
[turntable]
angles = 40
[vial]
radius = "4 mm"
wall = "0.5 mm"
resin_index = 1.5
wall_index = 1.5
absorption = "0.1 1/mm"
[solve]
iterations = 20
"""
OTHER = """
[method]
kind = "osmo"
"""
DULL = 'fill = 0.8\nspread = "120 um"\n[turntable]'
TURNS = 6
live: Any = vamgpu.live  # of the package that it shares its name with, type checkers see that alone
OFF = Truth(inhibitor=0.5, lamp=0.95)
REAL = """
[rig]
name = "lab"
machine = "vial"
[controller]
port = "/dev/none"
[motion]
driver = "controller"
microsteps = 100.0
[display]
driver = "alp"
library = "none.so"
[[feedback]]
driver = "camera"
producer = "none.cti"
"""


@pytest.fixture(scope="module")
def nut(tmp_path_factory: pytest.TempPathFactory) -> Path:
    job, left = _begun(
        Job,
        JOB.replace("iterations = 20", 'iterations = 20\nmethod = "lbfgs"'),
        tmp_path_factory.mktemp("nut"),
        "nut",
        (),
        "report.html",
    )
    solve(job, left.folder, overwrite=True)
    return left.folder


@pytest.fixture(scope="module")
def dull(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of another method, whose doses have a unit of their own, by a beam that is not the usual one."""
    given = JOB.replace("[turntable]", DULL).replace("iterations = 20", "iterations = 40") + OTHER
    job, left = _begun(Job, given, tmp_path_factory.mktemp("dull"), "dull", (), "report.html")
    solve(job, left.folder, overwrite=True)
    return left.folder


def versions(told: RunRecord) -> set[int]:
    return set(told.shown["version"].tolist())


def test_levels_show_the_light_that_was_decided(nut: Path) -> None:
    frames = load_frames(nut, "cpu")
    operator = prove(nut, "cpu").proof.operator
    light = light_of(frames, TURNS)
    assert np.array_equal(levels_of(light, frames, TURNS, operator), frames.levels())
    half = levels_of(0.5 * light, frames, TURNS, operator).astype(float)
    assert np.abs(half - 0.5 * frames.levels()).max() <= 0.5 + 1e-6
    assert not levels_of(0 * light, frames, TURNS, operator).any()


@pytest.mark.filterwarnings("ignore:at 40 angles rounding")
def test_light_for_bits_that_were_chosen_by_dose_is_shown_too() -> None:
    part = np.zeros((16, 16, 2), np.float32)
    part[5:11, 5:11] = 1.0
    A = vamgpu.Projection(vamgpu.Grid((16, 16, 2), 0.1), vamgpu.Beam((24, 2), 0.1), vamgpu.Turntable(40))
    frames = vamgpu.pack(vamgpu.optimize(A, part, "lbfgs", 4, progress=False), 1, dither="fit")
    given = light_of(frames, TURNS)
    shown = levels_of(0.5 * given, frames, TURNS, A)
    assert shown.dtype == np.uint8 and set(np.unique(shown)) == {0, 1}
    assert shown.sum() == pytest.approx(0.5 * frames.levels().sum(), rel=0.1)


def test_a_watched_print_reaches_the_resin_and_repeats_bit_by_bit(nut: Path, run: Path) -> None:
    board = Board()
    ended = live(nut, turns=TURNS, folder=run, truth=OFF, evaluations=4.0, board=board)
    assert ended.state is PrintState.COMPLETE and "proved overlap" in str(ended)
    told = read_run(run)
    swaps = [event for event in told.events if event["event"] == "swap"]
    assert swaps and not [event for event in told.events if event["event"] in ("live lost", "live refused")]
    found = [each for each in ended.decisions if each["parameters"]]
    assert found and [each["turn"] for each in ended.decisions] == list(range(1, len(ended.decisions) + 1))
    assert abs(found[-1]["inhibitor"] - OFF.inhibitor) < 0.2
    lit = told.shown[told.shown["frame"] >= 0]
    assert len(lit) / 40 < TURNS, "aged resin is done sooner"
    checked = {each["turn"]: each["checks"] for each in ended.decisions}
    assert {(each.turn, each.name): [each.value, each.limit] for each in board.now.checks} == {
        (turn, name): pair for turn, checks in checked.items() for name, pair in checks.items()
    }
    assert {name for checks in checked.values() for name in checks} == {"images", "conversion"}
    assert not [event for event in told.events if event["event"] == "live doubted"]
    assert board.now.period == 40 and board.now.stop == len(lit) / 40
    assert board.now.left is not None and board.now.left < 9.0 / 40, "to the stop, not to the longest print"
    names = [each.name for each in board.now.parameters]
    assert {"sensitivity", "inhibitor", "expected stop [turn]"} <= set(names)
    assert {name.partition(";")[0] for name in board.now.maps} == {"dose", "conversion seen"}
    for drawn in board.now.maps.values():
        assert drawn.dtype == np.uint8 and drawn.ndim == 3 and (drawn == 255).all(axis=2).any(), "the part is outlined"
    firsts = {int(told.shown["slot"][told.shown["version"] == number][0]) // 40 for number in versions(told)}
    changed = next(each for each in ended.decisions if each["version"])
    swapped = [changed, *(each for each in ended.decisions if each["action"] == "swap")]
    assert {each["effective"] for each in swapped} <= firsts, "each as the print showed it"
    assert all(each["stages"]["sense"] == pytest.approx(0.6 * 9.0, abs=0.3) for each in ended.decisions)
    assert all({"see", "estimate", "replan", "pack", "upload"} <= set(each["stages"]) for each in swapped)
    unwatched = live(nut, turns=TURNS, truth=OFF, watched=False)
    assert ended.iou is not None and unwatched.iou is not None and ended.iou > unwatched.iou + 0.02
    replayed = list(LiveRecord(run / "live").replay())
    assert len(replayed) == len(ended.decisions) and not any(differs for _, differs in replayed)
    made = page(LiveRecord(run / "live"), OFF, (unwatched.iou, ended.iou), ended.conversion)
    text = made.write(run / "live.html").read_text(encoding="utf-8")
    assert all(f"<td>{each['reason']}</td>" in text for each in ended.decisions) and f"{ended.iou:.4f}" in text
    assert "sensitivity" in text and text.count("data:image/webp") == 1 and ">nan<" not in text
    assert not [drawn for drawn in text.split("<svg")[1:] if chart.WARN in drawn.partition("</svg>")[0]], "none is red"
    with pytest.raises(StorageError, match="exists"):
        live(nut, turns=TURNS, folder=run)


@pytest.mark.slow
def test_the_job_s_light_prints_whatever_its_unit_and_beam(
    dull: Path, run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    proof = prove(dull, "cpu").proof
    assert abs(proof.scores.threshold / 0.865 - 1.0) > 0.03, "else this tests nothing"
    unwatched = live(dull, turns=TURNS, watched=False)
    assert unwatched.iou == pytest.approx(proof.scores.iou, abs=0.02) and unwatched.turns == TURNS
    monkeypatch.setattr(live_print, "WAIT", 20.0)
    monkeypatch.setattr(live_print, "FOLLOW", "live_workers:raises")
    alone = live(dull, turns=TURNS, folder=run)
    assert np.allclose(alone.conversion, unwatched.conversion, atol=0.01), "the machines give what the plan does"
    assert str(alone).splitlines()[0].endswith(f"complete after {TURNS} turns")


@pytest.mark.slow
def test_the_loop_plans_by_the_job_s_own_beam_and_names_its_device(dull: Path, run: Path) -> None:
    live(dull, turns=2, folder=run)
    record, beam = LiveRecord(run / "live"), prove(dull, "cpu").proof.operator.beam
    setup = record.setup()
    assert setup.projection(setup.vial).beam == beam and beam.fill == 0.8 and beam.spread == pytest.approx(0.12)
    assert setup.camera().projection.beam.fill == 1.0, "the camera has a lens of its own"
    assert setup.device == open_device().name
    first = LiveRecord(run / "other").begin(setup, record.part(), np.load(run / "live" / "live-light.npy"))
    dose = first.estimator.operator.T(setup.planned * first.light)
    part = record.part() >= 0.5
    assert ((dose >= setup.resin.solid) == part).mean() > 0.99


@pytest.mark.parametrize("function", ["raises", "nan", "silent"])
@pytest.mark.slow
def test_whatever_becomes_of_the_loop_the_print_ends_as_planned(
    nut: Path, run: Path, monkeypatch: pytest.MonkeyPatch, function: str
) -> None:
    monkeypatch.setattr(live_print, "FOLLOW", f"live_workers:{function}")
    monkeypatch.setattr(live_print, "WAIT", 0.004 if function == "silent" else 20.0)
    live(nut, turns=3, folder=run, truth=OFF)
    told = read_run(run)
    kinds = {event["event"] for event in told.events}
    assert {"raises": "live lost", "nan": "live refused", "silent": "live silent"}[function] in kinds
    shown = told.shown[told.shown["frame"] >= 0]
    assert len(shown) == 3 * 40 and not shown["version"].any()


def test_what_cannot_be_watched_is_refused(nut: Path, run: Path) -> None:
    with pytest.raises(BadInput, match="expected --rig emulated"):
        print_("demo", "live", rig="lab.toml", given=PrintOptions(out=run))
    with pytest.raises(BadInput, match="takes one job"):
        print_(str(nut), rig="emulated", given=PrintOptions(live=True, stop=0.3, out=run))
    with pytest.raises(BadInput, match="turns"):
        live(nut, turns=1)
    with pytest.raises(BadInput, match="longest"):
        live(nut, turns=6, longest=5)
    for given in (0, 1):
        with pytest.raises(BadInput, match=f"turns is {given}"):
            print_(str(nut), rig="emulated", given=PrintOptions(live=True, turns=given, out=run))
    with pytest.raises(BadInput, match="emulated machines"):
        lab = run.parent / "lab.toml"
        lab.write_text(REAL)
        live(nut, lab, turns=TURNS, folder=run, camera=RedCamera(), watched=False)
    with pytest.raises(JobError, match="vam calibrate live"):
        live(nut, lab, turns=TURNS, folder=run)
    for wrong in ({"evaluations": 0}, {"evaluations": float("nan")}, {"seed": -1}, {"camera": 3}, {"truth": 3}):
        with pytest.raises(BadInput, match=next(iter(wrong))):
            live(nut, turns=TURNS, folder=run, **wrong)
    with pytest.raises(BadInput, match="brightest level is 1023"):
        live(nut, turns=TURNS, folder=run, camera=RedCamera(open_field=5000.0))
    assert not run.exists()


@pytest.mark.parametrize("angles", ['range = "180 deg"', "angles = 1"])
def test_other_angles_are_refused(tmp_path: Path, angles: str) -> None:
    given = JOB.replace("angles = 40", angles if "angles" in angles else f"angles = 40\n{angles}")
    job, left = _begun(Job, given.replace("iterations = 20", "iterations = 2"), tmp_path, "odd", (), "report.html")
    solve(job, left.folder, overwrite=True)
    with pytest.raises(JobError, match="angles: +no, .* evenly spaced angles over a full turn; solve it with"):
        live(left.folder, turns=TURNS, folder=tmp_path / "run")
    with pytest.raises(StorageError, match="a run that was watched"):
        LiveRecord(left.folder).setup()


@pytest.mark.slow
def test_a_camera_of_its_own_size_and_orientation_watches_as_well(nut: Path, run: Path) -> None:
    lab = run.parent / "lab.toml"
    given = 'pixel = "80 um"\nbits = 12\ncrop = [4, 8, 160, 120]\nflip = true\nrotation = 90'
    lab.write_text(EMULATED.replace('pixel = "7.8 um"', given))
    ended = live(nut, lab, turns=TURNS, folder=run, truth=OFF, evaluations=4.0)
    unwatched = live(nut, lab, turns=TURNS, truth=OFF, watched=False)
    assert ended.iou is not None and unwatched.iou is not None and ended.iou > unwatched.iou + 0.02
    assert not any(each["doubt"] for each in ended.decisions) and any(each["parameters"] for each in ended.decisions)
    assert not any(differs for _, differs in LiveRecord(run / "live").replay())
    assert 0.5 < ended.decisions[0]["misfit"] < 1.5, "the noise of the resampled images is as it is said"


@pytest.mark.slow
def test_the_command_s_dry_run_cures_resin_and_writes_the_report(nut: Path, run: Path, capsys: Any) -> None:
    assert print_(str(nut), rig="emulated", given=PrintOptions(live=True, turns=3, speed="90", out=run)) == 0
    assert "proved overlap" in capsys.readouterr().out and (run / "live.html").is_file()


class Replayed:
    """A planner's connection that gives the messages of a recorded print, and answers each proposal."""

    def __init__(self, task: dict[str, Any], messages: list[dict[str, Any]]) -> None:
        self.task, self._messages, self.proposals = task, messages, list[int]()

    def __iter__(self) -> Iterator[dict[str, Any]]:
        for message in self._messages:
            yield message
            while len(self.proposals) > self.task["answered"]:
                self.task["answered"] += 1
                yield {"answer": {"number": self.task["answered"]}}

    def propose(self, levels: Any, turn: int, stop: int | None = None) -> None:
        self.proposals.append(turn)

    def estimate(self, *_: Any) -> None: ...

    def checked(self, *_: Any, **__: Any) -> None: ...


def test_a_resumed_print_decides_as_one_that_never_stopped(nut: Path, run: Path) -> None:
    made = live_print.watched_plan(nut, read_rig("emulated"), turns=TURNS, evaluations=4.0, truth=OFF)
    resin = resin_of(made.planned, made.order.settings, made.order.resin or {})
    dose, messages = resin.printer.dose(made.light), list[list[dict[str, Any]]]()
    for turn in range(1, 5):
        resin.printer.turn(dose)
        images = resin.printer.through()
        messages.append(
            [{"image": each, "angle": 360.0 * (turn + (k + 0.5) / 40), "at": k} for k, each in enumerate(images[:25])]
        )

    def follow(folder: Path, *parts: list[list[dict[str, Any]]]) -> list[dict[str, Any]]:
        task = {"jobs": [str(nut)], "folder": str(folder), "settings": made.order.settings, "turns": 12, "frames": 40}
        for part in parts:
            Following(Replayed(task | {"answered": 0}, [each for turn in part for each in turn])).run()  # type: ignore[arg-type]
        return LiveRecord(folder / "live").decisions

    whole, broken = follow(run / "whole", messages), follow(run / "broken", messages[:3], messages[3:])
    assert len(whole) == len(broken) == 4 and any(each["parameters"] for each in whole)
    for one, other in zip(whole, broken, strict=True):
        assert {name: one[name] for name in ENTRY} == {name: other[name] for name in ENTRY}


def test_a_state_is_corrected_by_what_was_shown() -> None:
    a, b = np.zeros((1, 1, 1)), np.ones((1, 1, 1))
    state = LiveState(3, a, a, b, 4, 2, committed=(b,))
    corrected = LiveLoop.corrected(None, state, {0: a, 2: b}, [0, 2])  # type: ignore[arg-type]
    assert corrected.committed[0] is a and corrected.light is b and corrected.version == 2

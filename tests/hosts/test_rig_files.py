"""The rig files of docs/rigs, each rehearsed end to end from its file, and judged by what emulated resin saw."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from math import ceil
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from test_planning import Shifted, vial, web

from vamgpu.cli import main
from vamgpu.errors import BadInput, DeviceError, TimingInfeasible
from vamgpu.hosts.records.record import read_run
from vamgpu.hosts.records.state import PrintState
from vamgpu.hosts.rig import PrintPlan, Rehearsal, carry_out, plan, rehearsal
from vamgpu.hosts.rigs.config import RigConfig, parse_rig, read_rig
from vamgpu.hosts.safety.interlock import InterlockOpen
from vamgpu.printing.given_dose import ProvedDose

RIGS = Path(__file__).parents[2] / "docs" / "rigs"
IMAGES = 60
CABLED = ("lightcrafter_kcube", "opencal")
APART = 100e-6
"""How far two clocks of 50 ppm each may be apart."""


def job(name: str, place: Path) -> Path:
    return web(place) if name == "roll_bench" else vial(place, images=IMAGES)


def planned(name: str, place: Path) -> PrintPlan:
    return plan(job(name, place), read_rig(RIGS / f"{name}.toml"), rehearsed=True,
                speed=0.8 if name == "roll_bench" else None, turns=1)  # fmt: skip


def bound(name: str) -> float:
    """The greatest difference of a frame's light that the rig's file accepts, of full on."""
    if name in CABLED:
        return 0.02  # a slot at the edge of an angle
    drifted = 40.0 * APART * (9.0 + 15.0)  # in a turn, and a turn and a half before it [deg]
    return drifted / (360.0 / IMAGES) if name == "pi_video_stepper" else 1e-6


def seen(one: PrintPlan, place: Path, spoil: Callable[[Rehearsal], None] = lambda stand: None) -> Any:
    stand = rehearsal(one)
    spoil(stand)
    assert carry_out(one, stand.machines, place)[0] is PrintState.COMPLETE
    return stand.monitor.verdict()


NAMES = [path.stem for path in sorted(RIGS.glob("*.toml"))]


def test_all_are_here() -> None:
    assert NAMES == ["epfl", "lightcrafter_kcube", "opencal", "pi_video_stepper", "roll_bench", "vialux_zaber"]


@pytest.mark.parametrize("name", NAMES)
def test_each_is_rehearsed_from_its_file(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, run = job(name, tmp_path / "job.vam"), tmp_path / "out.run"
    speed = ("--speed", "0.8") if name == "roll_bench" else ("--turns", "1")
    rig = str(RIGS / f"{name}.toml")
    assert main(["print", str(folder), "--rig", rig, "--dry-run", "--out", str(run), *speed]) == 0
    told = capsys.readouterr().out
    assert "complete: " in told and "machines                    emulated" in told
    kind = "guaranteed" if name == "roll_bench" else "not there"
    assert re.search(f"^  lease +{kind}: ", told, re.M) and re.search(f"^  interlock +{kind}: ", told, re.M)
    kept = {one["about"]: one["holds"] for one in read_run(run).asked["guarantees"]}
    assert kept["lease"] == (name == "roll_bench") and kept["step"] == (name != "pi_video_stepper")
    verdict = seen(planned(name, tmp_path / "again.vam"), tmp_path / "again.run")
    assert verdict.frames == (270 if name == "roll_bench" else IMAGES)
    assert verdict.greatest < bound(name) and verdict.beside < 1e-9, verdict


@pytest.mark.parametrize("name", NAMES)
def test_a_shift_by_one_slot_is_caught(name: str, tmp_path: Path) -> None:
    def shift(stand: Rehearsal) -> None:
        stand.monitor._sources = tuple(map(Shifted, stand.monitor._sources))

    assert seen(planned(name, tmp_path / "job.vam"), tmp_path / "run", shift).greatest > 0.5


@pytest.mark.parametrize("name", NAMES)
def test_an_inverted_motion_is_caught(name: str, tmp_path: Path) -> None:
    def invert(stand: Rehearsal) -> None:
        true = stand.emulated.recorder._position
        stand.emulated.recorder._position = lambda now: -true(now)

    assert seen(planned(name, tmp_path / "job.vam"), tmp_path / "run", invert).greatest > 0.5


PI = (RIGS / "pi_video_stepper.toml").read_text(encoding="utf-8")
INDEX = PI + '\n[[feedback]]\ndriver = "index"\npin = 17\n'


def test_an_index_ends_the_drift(tmp_path: Path) -> None:
    folder, off = vial(tmp_path / "job.vam", images=IMAGES), []
    for number, text in enumerate((PI, INDEX)):
        one = plan(folder, parse_rig(text), rehearsed=True, turns=8)
        off.append(seen(one, tmp_path / f"run{number}").greatest)
    turn = 360.0 * APART / (360.0 / IMAGES)
    assert off[1] < 4 * turn < off[0], "what drifts until the second mark, in poses"
    assert not plan(
        folder, parse_rig(INDEX.replace("drift = 0.25", "drift = 0.0")), rehearsed=True, turns=1
    ).guarantees.drift


def test_pose_0_is_at_the_index_wherever_the_motor_was(tmp_path: Path) -> None:
    one = plan(vial(tmp_path / "job.vam", images=IMAGES), parse_rig(INDEX), rehearsed=True, turns=1)

    def turned(stand: Rehearsal) -> None:
        stand.emulated.stepper._pieces[0] = (0, 100_000.0, 0.0)

    assert seen(one, tmp_path / "run", turned).greatest < bound("pi_video_stepper")


def test_the_drift_is_the_one_that_was_told(tmp_path: Path) -> None:
    one = plan(vial(tmp_path / "job.vam", images=IMAGES), parse_rig(PI), rehearsed=True, turns=1)
    stand = rehearsal(one)
    carry_out(one, stand.machines, tmp_path / "run")
    stepper, clock = stand.emulated.stepper, stand.emulated.clock
    machines: Any = stand.machines
    minutes = clock.now() / 60e9
    assert stepper.position(clock.now()) / 1000.0 - machines.stage.position() == pytest.approx(
        one.guarantees.drift * minutes, rel=0.05
    )


def test_a_stalled_stepper_is_seen_by_its_index_alone(tmp_path: Path) -> None:
    folder = vial(tmp_path / "job.vam", images=IMAGES)
    for text, fails in ((PI, False), (INDEX, True)):
        one = plan(folder, parse_rig(text), rehearsed=True, turns=4)
        stand = rehearsal(one)
        machines: Any = stand.machines
        projector = machines.projector
        show, frames = projector.show, []

        def stalling(slots: list[np.ndarray], stand: Any = stand, show: Any = show, frames: Any = frames) -> int:
            frames.append(any(slot.any() for slot in slots))
            if sum(frames) == 120:
                stand.emulated.stepper.stall()
            return show(slots)

        projector.show = stalling
        if fails:
            with pytest.raises((DeviceError, InterlockOpen), match="no index for 1.2 turns|off position"):
                carry_out(one, stand.machines, tmp_path / "seen")
            assert not stand.emulated.screen._frame.any(), "black"
        else:
            carry_out(one, stand.machines, tmp_path / "unseen")
            assert stand.monitor.verdict().greatest > 0.5


def test_a_lightcrafter_before_a_thorlabs_stage(tmp_path: Path) -> None:
    rig = parse_rig(
        '[rig]\nname = "lab"\nmachine = "vial"\n[motion]\ndriver = "thorlabs"\nport = "/dev/x"\nmicrosteps = 1919.64\n'
        "encoder = true\n"
        '[display]\ndriver = "lightcrafter"\n[light]\ndriver = "display"\n'
    )
    one = plan(vial(tmp_path / "job.vam", images=60), rig, rehearsed=True, turns=1)
    lacking = [each.about for each in one.guarantees.lacking]
    assert lacking == ["display", "scale", "light", "lease", "interlock", "lamp"]
    assert seen(one, tmp_path / "run").greatest < 0.02


def test_a_rig_that_drifts_is_refused_until_that_is_accepted(tmp_path: Path) -> None:
    rig = parse_rig(PI, ["safety.drift=0.2"])
    folder = vial(tmp_path / "job.vam", images=IMAGES)
    with pytest.raises(BadInput, match="drifts 0.24 deg per minute"):
        plan(folder, rig, turns=1, speed=40)
    slower = plan(folder, rig, turns=1)
    assert float(slower.schedule.speed) == pytest.approx(360 / 11), "the fastest that drifts by less"


@pytest.mark.slow
def test_a_web_before_a_video_projector_fits_the_cable_or_is_refused(tmp_path: Path) -> None:
    film = web(tmp_path / "web.vam", None)
    rig = parse_rig(
        '[rig]\nname = "lab"\nmachine = "web"\n[controller]\nport = "/dev/x"\n[motion]\ndriver = "zaber"\n'
        'port = "/dev/y"\n[display]\ndriver = "video"\n'
    )
    with pytest.raises(TimingInfeasible, match="images every 0.183") as refused:
        plan(film, rig, speed=0.8, rehearsed=True)
    one = plan(film, rig, speed=refused.value.speed, rehearsed=True)
    assert float(one.schedule.speed) == pytest.approx(float(one.schedule.advance) * 120 / 28)
    verdict = seen(one, tmp_path / "run")
    assert verdict.frames == len(one.schedule) and verdict.greatest < 0.02, verdict


KNOWN = ProvedDose(seconds=30.0, irradiance=1.0, scale=1.0, least=0.95, most=1.06, right=True)


SHORT = replace(KNOWN, seconds=7.7)


def remedied(
    place: Path, rig: RigConfig, images: int, known: ProvedDose | Literal[False], speed: float | None = None
) -> PrintPlan:
    """The plan of a job, after the remedy of its refusal if it is refused; the remedy is followed to the word."""
    turns = None if known else 2
    try:
        return plan(vial(place / "job.vam", images=images), rig, speed=speed, turns=turns, exposure=known)
    except (TimingInfeasible, BadInput) as refused:
        remedy = str(refused).rpartition(": ")[2]
    told = re.fullmatch(r"(print with)?(?: --speed (\S+))?(?: --turns (\d+).*)?", remedy)
    if told is not None and (told[2] or told[3]):
        speed, turns = float(told[2]) if told[2] else speed, int(told[3]) if told[3] else turns
    elif told := re.fullmatch(r"solve the job with angles = (\d+) in \[turntable\]", remedy):
        images, known = int(told[1]), known and KNOWN  # what is solved again is proved again
    elif told := re.fullmatch(
        r"(?:frames cannot be shorter, so|dim the projector and) set power = (\S+) in \[light\]", remedy
    ):
        rig = read_rig(rig.source, [f"light.power={told[1]}"])
    else:
        raise AssertionError(f"no remedy in {remedy!r}")
    return plan(vial(place / f"{images}.vam", images=images), rig, speed=speed, turns=turns, exposure=known)


VIALS = [file for file in sorted(RIGS.glob("*.toml")) if read_rig(file).setup.rig.machine == "vial"]


@pytest.mark.parametrize("counts", [(60, 100, 720), pytest.param((24, 36, 48, 90, 180, 360), marks=pytest.mark.slow)])
@pytest.mark.parametrize("file", VIALS, ids=lambda file: file.stem)
@pytest.mark.filterwarnings("ignore::vamgpu.errors.DoseWarning")
def test_a_rig_prints_any_number_of_angles_at_its_usual_speed_or_by_the_remedy(
    file: Path, counts: tuple[int, ...], tmp_path: Path
) -> None:
    rig = read_rig(file)
    for images in counts:
        for number, known in enumerate((KNOWN, SHORT, replace(KNOWN, seconds=1.0), False)):
            place = tmp_path / f"{images} {number}"
            made = remedied(place, rig, images, known)
            speed = float(made.schedule.speed)
            if rig.setup.video and known is False:
                assert made.display is not None
                slots = 360 / images * made.display.slot_rate / speed
                faster = 360 / images * float(made.display.slot_rate) / (round(slots) - 1) if slots > 1.5 else np.inf
                assert slots == pytest.approx(round(slots), rel=1e-5) and speed <= 40 < faster, "the fastest"
            assert known is False or (made.dose is not None and (made.dose.keeps or made.dose.asked))
            if made.display is not None and known is KNOWN:
                seconds = images / float(made.display.slot_rate)  # of a turn of one slot an image
                lit = (1 - float(made.display.dark * made.display.slot_rate)) / 30
                whole = any(0.95 <= turns * slots * seconds * lit <= 1.06 for turns in range(1, 4)
                            for slots in range(ceil(9 / seconds - 1e-9), ceil(40 / seconds)))  # fmt: skip
                dimmed = made.rig.setup.light.power < rig.setup.light.power
                assert dimmed != whole and not (made.dose and made.dose.asked), "no remedy where whole turns fit"
                assert made.dose is not None and made.dose.keeps and speed <= 40


@pytest.mark.parametrize("known", [KNOWN, SHORT, False], ids=["long", "short", "turns"])
@pytest.mark.parametrize("images", [
    7, 100, 360, *(pytest.param(images, marks=pytest.mark.slow) for images in (60, 120, 144, 300)),
])  # fmt: skip
@pytest.mark.parametrize("speed", [10.0, 40.0])
@pytest.mark.filterwarnings("ignore::vamgpu.errors.DoseWarning")
def test_the_remedy_of_a_refused_speed_is_accepted(
    tmp_path: Path, images: int, speed: float, known: ProvedDose | Literal[False]
) -> None:
    made = remedied(tmp_path, read_rig(RIGS / "pi_video_stepper.toml"), images, known, speed)
    assert known is False or (made.dose is not None and (made.dose.keeps or made.dose.asked))

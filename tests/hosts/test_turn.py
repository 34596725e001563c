"""How far a vial turns for a degree that its motion reports: found by a camera and a mark, and applied by prints."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_planning import vial

from vamgpu.cli import main
from vamgpu.errors import BadInput, JobError
from vamgpu.hosts.calibrate.connection import opened_turn, turning
from vamgpu.hosts.calibrate.machines import CalibrationMachines
from vamgpu.hosts.calibrate.report import keep
from vamgpu.hosts.calibrate.turn import turn
from vamgpu.hosts.emulators.calibration import marked_vial
from vamgpu.hosts.rig import plan
from vamgpu.hosts.rigs.config import RigConfig, parse_rig, read_rig

CAMERA = '\n[[feedback]]\ndriver = "camera"\nproducer = "a.cti"\nexposure = "5 ms"\n'
OPENCAL = (Path(__file__).parents[2] / "docs" / "rigs" / "opencal.toml").read_text("utf-8") + CAMERA


def emulated(rig: RigConfig, ratio: float = 1.009) -> CalibrationMachines:
    return turning(rig.setup, *marked_vial(ratio))


SPEEDS = [pytest.param(*case, marks=pytest.mark.slow) for case in ((0.87, 60.0), (1.0, 6.0), (1.00925, 40.0))]


@pytest.mark.parametrize(("ratio", "speed"), [*SPEEDS, (1.15, 6.0)])
def test_the_turn_is_found_within_its_error(ratio: float, speed: float) -> None:
    found = turn(emulated(parse_rig(OPENCAL), ratio), speed=speed, turns=4).numbers
    assert found["error"] < 1e-4 and abs(found["ratio"] - ratio) < max(4 * found["error"], 2e-6)
    assert found["rpm"] == pytest.approx(speed * ratio / 6.0, rel=1e-4)
    assert found["microsteps"] == pytest.approx(3200 / 360 / ratio, rel=1e-4)


def test_its_error_bounds_what_repeats_differ_by() -> None:
    off = []
    for seed in range(4):
        machines = emulated(parse_rig(OPENCAL), 1.0032)
        machines.camera._random = np.random.default_rng(seed)  # type: ignore[attr-defined]
        found = turn(machines, turns=3).numbers
        off.append((found["ratio"] - 1.0032) / found["error"])
    assert 0.02 < np.std(off) < 1.5 and np.max(np.abs(off)) < 3.0, off


def test_without_a_mark_or_turns_there_is_no_number() -> None:
    machines = emulated(parse_rig(OPENCAL))
    scene = machines.camera.scene  # type: ignore[attr-defined]
    still = scene(0)
    machines.camera.scene = lambda now: still  # type: ignore[attr-defined]
    with pytest.raises(BadInput, match="draw a mark"):
        turn(machines, turns=3)
    machines.camera.grab = lambda: np.zeros((32, 32))  # type: ignore[method-assign]
    with pytest.raises(BadInput, match="explains 0 % .* draw a mark"):
        turn(machines, turns=3)
    with pytest.raises(BadInput, match="3 turns or more"):
        turn(machines, turns=2)
    stepped = '[rig]\nname = "lab"\nmachine = "vial"\n[controller]\nport = "/dev/x"\n'
    stepped += '[motion]\ndriver = "controller"\nmicrosteps = 80\n[display]\ndriver = "alp"\n'
    with pytest.raises(BadInput, match="index or encoder"):
        opened_turn(parse_rig(f'{stepped}library = "x"\n{CAMERA}'))
    with pytest.raises(JobError, match="has no camera"):
        opened_turn(parse_rig(OPENCAL.replace(CAMERA, "")))


def test_a_motion_stops_when_the_camera_fails() -> None:
    machines = emulated(parse_rig(OPENCAL))
    stopped: list[float] = []
    stage: Any = machines.stage
    run = stage.run
    stage.run = lambda speed: stopped.append(speed) or run(speed)

    def lost() -> np.ndarray:
        raise OSError("unplugged")

    machines.camera.grab = lost  # type: ignore[method-assign]
    with pytest.raises(OSError):
        turn(machines)
    assert stopped == [40.0, 0.0]


@pytest.mark.slow
def test_prints_apply_it(tmp_path: Path) -> None:
    file = tmp_path / "lab.toml"
    file.write_text(OPENCAL, "utf-8")
    rig, job = read_rig(file), vial(tmp_path / "job.vam", images=60)
    before = plan(job, rig, rehearsed=True, turns=1).rig.setup.motion.microsteps
    keep(turn(emulated(rig, 1.00925), turns=4), rig)
    one = plan(job, rig, rehearsed=True, turns=1)
    assert (
        one.rig.setup.motion.microsteps == pytest.approx(before / 1.00925, rel=1e-5) and "turn" in one.calibration.used
    )
    off = read_rig(file, ['calibration.turn="none"'])
    assert plan(job, off, rehearsed=True, turns=1).rig.setup.motion.microsteps == before
    grbl = read_rig(file, ["motion.driver=grbl", "motion.port=/dev/x", "motion.microsteps=80"])
    told = plan(job, grbl, rehearsed=True, turns=1)
    assert told.rig.setup.motion.microsteps == 80.0 and any("check coupling" in note for note in told.calibration.notes)
    keep(turn(emulated(rig, 1.0), turns=4), rig)
    assert plan(job, rig, rehearsed=True, turns=1).rig.setup.motion.microsteps == before, "within its error, the file's"


def test_by_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["calibrate", "turn", "--rig", "emulated", "--turns", "3", "--out", str(tmp_path / "turn")]) == 0
    told = capsys.readouterr().out
    assert "rpm" in told and "emulated" in told and "microsteps" not in told, (
        "prints apply it: not once more in the file"
    )
    assert (tmp_path / "turn" / "figure.png").stat().st_size
    assert isinstance(opened_turn(read_rig("emulated"))[0], CalibrationMachines)

"""Every rig of docs/rigs with a camera is calibrated and watched, or is refused with all its needs at once."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_rig_files import NAMES, RIGS
from test_watched import JOB, OFF, TURNS

from vamgpu.errors import JobError
from vamgpu.hosts.calibrate import live as live_run
from vamgpu.hosts.calibrate.connection import rehearsal
from vamgpu.hosts.calibrate.report import keep
from vamgpu.hosts.calibrate.truth import compared
from vamgpu.hosts.drivers.camera import Buffered
from vamgpu.hosts.emulators.calibration import Optics
from vamgpu.hosts.live.cameras import RedCamera, _measured
from vamgpu.hosts.live.live_print import _emulated, watched_plan
from vamgpu.hosts.process.live_camera import LiveCamera
from vamgpu.hosts.records.state import PrintState
from vamgpu.hosts.rigs.calibrations import MEASURED, measured
from vamgpu.hosts.rigs.config import RigConfig, read_rig
from vamgpu.jobs.demo import _begun
from vamgpu.jobs.read import Job
from vamgpu.jobs.run import solve
from vamgpu.live.sensor import SensorView

CAMERA = """
[[feedback]]
driver = "camera"
producer = "camera.cti"
exposure = "9 ms"
pixel = "80 um"
bits = 12
crop = [0, 0, 120, 160]
rotation = 90
"""
SLOW = ("lightcrafter_kcube", "pi_video_stepper", "vialux_zaber")
EACH = [pytest.param(name, marks=[pytest.mark.slow] if name in SLOW else []) for name in NAMES]
SIZE, PITCH, VIEW = (24, 64), 0.2, (120, 160)
SPEED = 36.0  # whole video frames for each of 40 angles


@pytest.fixture(scope="module")
def nut(tmp_path_factory: pytest.TempPathFactory) -> Path:
    given = JOB.replace("iterations = 20", 'iterations = 20\nmethod = "lbfgs"')
    job, left = _begun(Job, given, tmp_path_factory.mktemp("nut"), "nut", (), "report.html")
    solve(job, left.folder, overwrite=True)
    return left.folder


def rig_of(name: str, folder: Path, more: str = CAMERA) -> RigConfig:
    path = folder / f"{name}.toml"
    path.write_text((RIGS / f"{name}.toml").read_text("utf-8") + more)
    return read_rig(path)


def optics(size: tuple[int, int] = SIZE) -> Optics:
    return Optics(
        mirrors=size, pitch=PITCH, waist=0.05, depth=40.0, view=VIEW, rotation=90, radius=0.0, electrons=1.5e6,
        back=1.2e6,
    )  # fmt: skip


def calibrated(rig: RigConfig, size: tuple[int, int] = SIZE) -> RedCamera:
    machines, truth = rehearsal(rig, live_run.TABLES, optics(size))
    try:
        keep(compared(live_run.live(machines, repeats=4), truth, machines), rig)
    finally:
        machines.close()
    return _measured(measured(rig, "live"))


@pytest.mark.parametrize("name", EACH)
def test_the_camera_of_each_rig_is_found(name: str, tmp_path: Path) -> None:
    rig = rig_of(name, tmp_path)
    found, numbers = calibrated(rig), measured(rig, "live").tables()[MEASURED]
    true = SensorView.described((160, 120), SIZE, PITCH / 0.08, rotation=90, dark=numbers["dark"], bits=12)
    corners = np.array([(row, column) for row in (0, SIZE[0] - 1) for column in (0, SIZE[1] - 1)], float).T
    assert found.view is not None
    seen, expected = (np.array(view.matrix) @ corners + np.array(view.origin)[:, None] for view in (found.view, true))
    assert np.abs(seen - expected).max() < 3.0 * max(numbers["place_error_pixels"], 0.03)
    truth = measured(rig, "live").tables()["emulated"]
    assert numbers["gain"] == pytest.approx(truth["gain"], rel=0.01)
    assert numbers["read"] == pytest.approx(truth["read"], rel=0.3), "its error is tested apart"


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in NAMES if name != "roll_bench"])
def test_each_rig_is_watched_by_its_calibrated_camera(
    name: str, nut: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig, turns = rig_of(name, tmp_path), list[tuple[float, float]]()
    size = watched_plan(nut, rig, turns=TURNS, rehearsed=True, speed=SPEED).planned.mirrors[0]
    calibrated(rig, (size.rows, size.columns))
    made = watched_plan(nut, rig, turns=TURNS, evaluations=4.0, rehearsed=True, speed=SPEED, truth=OFF)
    grab = LiveCamera._grab

    def grabbed(self: Any) -> None:
        before = len(self._images)
        grab(self)
        if len(self._images) > before:
            vial = self._camera._emulated.recorder.pose(self._images[-1]["at"]) / 40
            turns.append((self._images[-1]["angle"] / 360.0, vial))

    monkeypatch.setattr(LiveCamera, "_grab", grabbed)
    ended = _emulated(made, tmp_path / "out.run", None, True)
    assert ended.state is PrintState.COMPLETE and ended.iou is not None
    assert not any(each["doubt"] for each in ended.decisions) and any(each["parameters"] for each in ended.decisions)
    angle, vial = np.array(turns).T
    apart = vial - angle
    assert angle[0] < 0.1, "the first images are of the first turn"
    assert np.ptp(apart) < 0.5 / 40 and abs(apart[0] - round(apart[0])) < 0.5 / 40, "their angles are the vial's"


def test_what_a_rig_lacks_is_told_at_once(nut: Path, tmp_path: Path) -> None:
    slow = CAMERA.replace("9 ms", "400 ms")
    with pytest.raises(JobError) as refused:
        watched_plan(nut, rig_of("roll_bench", tmp_path, slow))
    told = str(refused.value).splitlines()[1:]
    assert [line.split(",")[0].split() for line in told] == [
        ["job:", "yes"], ["angles:", "yes"], ["machine:", "no"], ["projector:", "yes"], ["camera:", "yes"],
        ["calibration:", "no"], ["images:", "no"],
    ]  # fmt: skip
    assert "vam calibrate live --rig" in told[5] and "turn at 22.5 deg/s at most" in told[6]
    with pytest.raises(JobError, match="camera: +no, the rig has none; add .*feedback"):
        watched_plan(nut, rig_of("epfl", tmp_path, ""))


def test_a_calibration_of_another_exposure_is_refused(nut: Path, tmp_path: Path) -> None:
    rig = rig_of("epfl", tmp_path)
    calibrated(rig)
    with pytest.raises(JobError, match="measured with 0.009 s, and .* has 0.005"):
        watched_plan(nut, rig_of("epfl", tmp_path, CAMERA.replace("9 ms", "5 ms")))


def test_an_image_of_an_earlier_pattern_is_never_used(tmp_path: Path) -> None:
    machines, _ = rehearsal(rig_of("opencal", tmp_path), live_run.TABLES, optics())
    camera, screen, lit = machines.camera, machines.screens[0], np.ones(SIZE, bool)
    assert isinstance(camera, Buffered)
    with live_run.CalibrationLight(machines) as light:
        light.on()
        bright = []
        for pattern in (~lit, lit, ~lit, lit):
            light.wait(0.1)  # images of the pattern before wait in the camera
            screen.show(pattern)
            bright.append(float(machines.shown(light).mean()))
    machines.close()
    assert bright[1] > 1.3 * bright[0], "the projector's light"
    assert bright[2] == pytest.approx(bright[0], rel=0.01) and bright[3] == pytest.approx(bright[1], rel=0.01)

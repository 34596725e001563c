"""Prints that stop when the resin scatters enough: in time on both kinds of projector, and dark whatever the camera."""

from __future__ import annotations

import errno
import threading
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vamgpu.cli import main
from vamgpu.errors import BadInput, DeviceLost, JobError, StorageError, WrongDevice
from vamgpu.hosts.drivers.camera import CameraDriver
from vamgpu.hosts.emulators.camera import ResinModel, ResinScene, RunningCamera, Sensor
from vamgpu.hosts.emulators.clock import PacedClock, VirtualClock
from vamgpu.hosts.player import exposure
from vamgpu.hosts.player.motor import POLL
from vamgpu.hosts.player.video import STEP
from vamgpu.hosts.records.record import RunFolder, RunRecord, read_run
from vamgpu.hosts.records.state import PrintState
from vamgpu.hosts.rig import PrintPlan, Rehearsal, carry_out, check, opened, plan, rehearsal, stopping
from vamgpu.hosts.rigs.config import EMULATED, RigConfig, parse_rig
from vamgpu.hosts.schedules.timing import SECOND
from vamgpu.printing.folder import save_frames
from vamgpu.printing.frames import Frames
from vamgpu.printing.gray import GrayCurve
from vamgpu.storage.folder import Entry

CABLE = """
[rig]
name = "cable"
machine = "vial"
[controller]
port = "/dev/does-not-exist"
[motion]
driver = "zaber"
port = "/dev/does-not-exist"
[display]
driver = "video"
[[feedback]]
driver = "camera"
producer = "/does/not/exist.cti"
exposure = "5 ms"
discard = 2
"""
RIGS = {"mirrors": parse_rig(EMULATED), "cable": parse_rig(CABLE)}
THRESHOLD, VOXELS = 2.0, 1000.0
QUICK = ResinModel(critical=10.0, width=1.0)
"""Gels in some turns of half-lit frames."""


@pytest.fixture
def job(tmp_path: Path) -> Path:
    images = np.random.default_rng(4).integers(0, 256, (36, 6, 10), dtype=np.uint8)
    frames = Frames.from_bytes(images, "numpy", bits=8, gray=GrayCurve.linear(), scale=1.0, columns=10)
    part = np.ones((10, 10, 10), np.float32)
    return save_frames(tmp_path / "part.vam", frames, arrays={"target": Entry(part, ("x", "y", "z"))}).path


def planned(job: Path, rig: RigConfig = RIGS["mirrors"], speed: float = 120.0, turns: int = 4) -> PrintPlan:
    return stopping(plan(job, rig, speed=speed, turns=turns, rehearsed=True), THRESHOLD)


def stand(wanted: PrintPlan, model: ResinModel = QUICK, paced: bool = False) -> tuple[Rehearsal, ResinScene]:
    found = rehearsal(wanted, paced)
    assert isinstance(found.machines.camera, RunningCamera)
    scene = found.machines.camera.scene
    assert isinstance(scene, ResinScene)
    scene.model = model
    return found, scene


class Truth:
    """Looks at emulated resin each millisecond, without a camera's noise, for when its scatter passes the threshold."""

    def __init__(self, clock: VirtualClock, scene: ResinScene, exposure_s: float) -> None:
        self._scene, self._gray = scene, exposure_s * 255 / Sensor().full_well
        self._background, self._at = float(scene(0).sum()), 0
        self.crossing: int | None = None
        clock.attach(self)

    def due(self) -> int | None:
        return self._at

    def advance(self, now: int) -> None:
        self._at = now + SECOND // 1000
        density = (float(self._scene(now).sum()) - self._background) * self._gray / VOXELS
        if self.crossing is None and density >= THRESHOLD:
            self.crossing = now


def light(run: RunRecord) -> list[tuple[str, int]]:
    return [(event["to"], event["at"]) for event in run.events if event["event"] == "light"]


def table(run: Path) -> np.ndarray:
    return np.loadtxt(run / "scatter.csv", delimiter=",", skiprows=1, ndmin=2)


@pytest.mark.parametrize("rig", RIGS)
def test_the_light_goes_out_within_a_frame_of_the_camera(job: Path, tmp_path: Path, rig: str) -> None:
    wanted = planned(job, RIGS[rig])
    emulated, scene = stand(wanted)
    truth = Truth(emulated.emulated.clock, scene, 0.005)
    state, printed = carry_out(wanted, emulated.machines, tmp_path / "run")
    run = read_run(tmp_path / "run")
    assert state is run.state is PrintState.COMPLETE and not emulated.emulated.controller.light
    assert [to for to, _ in light(run)] == ["on", "off"] and truth.crossing is not None
    latest = truth.crossing + exposure.PERIOD + POLL  # an image of the camera, and a poll that hears of it
    latest += 2 * round(float(wanted.schedule.cadence.period))  # no frame is cut
    lit = emulated.emulated.controller.lit
    assert any(lit(truth.crossing - k * SECOND // 200) for k in range(3)), "the image that brought it, at its end"
    assert not any(lit(latest + k * SECOND // 100) for k in range(50))
    assert 36 < len(run.shown) < 4 * 36 and printed.next == len(run.shown)
    seconds, density = table(run.path).T
    assert seconds[0] < 0 < seconds[1] and (np.diff(seconds) > 0).all() and density[0] == 0
    assert density[-1] >= THRESHOLD > density[1:-1].max() and np.allclose(np.diff(seconds[1:]), 0.1, atol=0.021)
    assert run.message == f"scatter density {density[-1]:.3g} reached 2 after {seconds[-1]:.1f} s"
    shown = [event for event in run.events if event["event"] == "enough"]
    assert [event["threshold"] for event in shown] == [2.0] and shown[0]["density"] == pytest.approx(density[-1])
    assert seconds[-1] == pytest.approx(len(run.shown) / 12, abs=0.15), "seconds count from the first frame"
    verdict = emulated.monitor.verdict(run.shown["frame"])
    near = {"mirrors": 1e-6, "cable": STEP / 3}[rig]  # as far as the stage is in step with the cable
    assert verdict.greatest < near and verdict.frames == 34 and verdict.beside < 1e-9


def test_a_part_that_never_scatters_enough_is_complete_with_a_warning(job: Path, tmp_path: Path) -> None:
    wanted = planned(job, turns=1)
    emulated, _ = stand(wanted)
    state, _ = carry_out(wanted, emulated.machines, tmp_path / "run")
    run = read_run(tmp_path / "run")
    assert state is run.state is PrintState.COMPLETE and len(run.shown) == 36 and not emulated.emulated.controller.light
    assert "of 2 in all its turns: the part may lack light" in run.message
    assert len(table(run.path)) > 25 and emulated.monitor.verdict().greatest < 1e-6


def test_a_pause_takes_no_new_background(job: Path, tmp_path: Path) -> None:
    wanted = planned(job)
    emulated, _ = stand(wanted)
    with RunFolder.begin(tmp_path / "run", {}, "") as folder:
        assert wanted.stop is not None and emulated.machines.camera is not None
        clock, lit = emulated.emulated.clock, [-1.0]
        with exposure.ScatterWatch(emulated.machines.camera, clock, wanted.stop, folder, lambda: lit[0]) as watch:
            watch.begin()
            assert watch.enough() is None and len(watch.rule.readings) == 0
            for lit[0] in (0.0, 5.0):
                clock.sleep(5 * SECOND)
                assert watch.enough() is None and watch.enough() is None
    seconds = table(tmp_path / "run")[:, 0]
    assert len(seconds) == 3 and seconds[2] - seconds[1] == pytest.approx(5.0, abs=0.1)


def test_an_overexposed_camera_is_told(job: Path, tmp_path: Path) -> None:
    wanted = stopping(plan(job, RIGS["mirrors"], speed=120.0, turns=3), 50.0)
    emulated, _ = stand(wanted)
    assert isinstance(emulated.machines.camera, RunningCamera)
    emulated.machines.camera.sensor = Sensor(full_well=5000.0)
    carry_out(wanted, emulated.machines, tmp_path / "run")
    run = read_run(tmp_path / "run")
    told = [event for event in run.events if event["event"] == "overexposed"]
    assert len(told) == 1 and told[0]["share"] > exposure.SATURATED
    assert f"overexposed from {told[0]['seconds']:.1f} s on" in run.message


class Failing:
    """A camera that gives some images and then fails, or hangs until it is closed."""

    def __init__(self, camera: CameraDriver, good: int, hangs: bool) -> None:
        self._camera, self._good, self._hangs, self.gone = camera, good, hangs, threading.Event()

    def expose(self, exposure_us: float) -> None:
        self._camera.expose(exposure_us)

    def grab(self) -> np.ndarray:
        self._good -= 1
        if self._good < 0 and self._hangs:
            self.gone.wait()
        if self._good < 0:
            raise DeviceLost("the camera gave no image: unplugged")
        return self._camera.grab()

    def close(self) -> None:
        self.gone.set()


def failed(job: Path, path: Path, good: int, hangs: bool, paced: bool) -> tuple[RunRecord, Any]:
    wanted = planned(job, speed=60.0)
    emulated, _ = stand(wanted, paced=paced)
    assert isinstance(emulated.emulated.clock, PacedClock) is paced and emulated.machines.camera is not None
    camera = Failing(emulated.machines.camera, good, hangs)
    emulated.machines.camera = camera
    try:
        with pytest.raises(DeviceLost, match="gave no image"):
            carry_out(wanted, emulated.machines, path, found=check(wanted, emulated.machines, seconds=0.02))
    finally:
        camera.close()
    return read_run(path), emulated.emulated


@pytest.mark.parametrize("paced", [False, True], ids=["in its turn", "in its thread"])
def test_a_camera_that_fails_ends_the_print_dark(job: Path, tmp_path: Path, paced: bool) -> None:
    run, emulated = failed(job, tmp_path / "run", 12, False, paced)
    assert [to for to, _ in light(run)] == ["on", "off"] and not emulated.controller.light
    assert run.state is PrintState.HELD and "unplugged" in run.message


def test_a_camera_that_hangs_ends_the_print_dark(job: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("vamgpu.hosts.process.execution.ScatterWatch", partial(exposure.ScatterWatch, patience=SECOND))
    monkeypatch.setattr(exposure, "LEAVE", 0.05)
    run, emulated = failed(job, tmp_path / "run", 12, True, paced=True)
    assert [to for to, _ in light(run)] == ["on", "off"] and not emulated.controller.light
    assert run.state is PrintState.HELD and "check its cable" in run.message


def test_a_camera_without_a_background_gets_no_light(job: Path, tmp_path: Path) -> None:
    run, emulated = failed(job, tmp_path / "run", 0, False, paced=True)
    assert run.state is PrintState.ERROR and not light(run) and not emulated.controller.light
    wanted = planned(job)
    emulated, _ = stand(wanted)
    assert isinstance(emulated.machines.camera, RunningCamera)
    emulated.machines.camera.sensor = Sensor(offset=255)
    with pytest.raises(BadInput, match="100.0 % of the camera's pixels are saturated before the light"):
        carry_out(wanted, emulated.machines, tmp_path / "bright")
    assert not light(read_run(tmp_path / "bright")) and read_run(tmp_path / "bright").state is PrintState.ERROR


def test_a_full_disk_is_the_error_that_is_told(job: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Full:
        """A file on a full disk: what it holds cannot be written when it is closed either."""

        def write(self, text: str) -> int:
            raise OSError(errno.ENOSPC, "No space left on device")

        close = flush = lambda self: self.write("")

    class Filling(exposure.ScatterWatch):
        def begin(self) -> None:
            super().begin()
            self._file = Full()  # type: ignore[assignment]

    monkeypatch.setattr("vamgpu.hosts.process.execution.ScatterWatch", Filling)
    wanted = planned(job)
    emulated, _ = stand(wanted)
    with pytest.raises(StorageError, match="'scatter.csv'"):
        carry_out(wanted, emulated.machines, tmp_path / "run")
    assert read_run(tmp_path / "run").state is PrintState.HELD and not emulated.emulated.controller.light


@pytest.mark.slow
def test_a_print_in_real_time_stops(job: Path, tmp_path: Path) -> None:
    wanted = planned(job, speed=240.0, turns=8)
    emulated, _ = stand(wanted, ResinModel(critical=1.0, width=0.2), paced=True)
    found = check(wanted, emulated.machines, seconds=0.02)
    state, _ = carry_out(wanted, emulated.machines, tmp_path / "run", found=found)
    run = read_run(tmp_path / "run")
    assert state is PrintState.COMPLETE and run.message.startswith("scatter density") and len(run.shown) < 4 * 36
    assert [to for to, _ in light(run)] == ["on", "off"] and table(run.path)[-1, 1] >= THRESHOLD
    assert not any(thread.name == "camera" for thread in threading.enumerate())


def test_what_cannot_be_watched_is_told(job: Path, tmp_path: Path) -> None:
    bare = parse_rig(EMULATED.replace('[[feedback]]\ndriver = "emulated camera"\nexposure = "5 ms"\npixel = "7.8 um"\n'
                                      "discard = 0\n", ""))  # fmt: skip
    with pytest.raises(JobError, match=r"no \[\[feedback\]\] with driver = .camera."):
        planned(job, bare)
    with pytest.raises(BadInput, match="threshold of scatter"):
        stopping(plan(job, RIGS["mirrors"], turns=1), 0.0)
    images = np.zeros((36, 6, 10), np.uint8)
    frames = Frames.from_bytes(images, "numpy", bits=8, gray=GrayCurve.linear(), scale=1.0, columns=10)
    with pytest.raises(StorageError, match="lacks its part"):
        planned(save_frames(tmp_path / "bare.vam", frames).path)
    wanted = planned(job)
    emulated, _ = stand(wanted)
    with pytest.raises(BadInput, match="fresh resin"):
        carry_out(wanted, emulated.machines, tmp_path / "run", resume=True)
    emulated.machines.camera = None
    with pytest.raises(WrongDevice, match="camera=True"):
        carry_out(wanted, emulated.machines, tmp_path / "run")
    assert not (tmp_path / "run").exists()
    with pytest.raises(Exception, match="does-not-exist"):
        opened(RIGS["cable"], camera=True)


@pytest.mark.slow
def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = tmp_path / "demo.run"
    assert main(["print", "demo", "--rig", "emulated", "--stop", "0.1", "--turns", "20", "--out", str(run)]) == 0
    said = capsys.readouterr().out
    assert (
        "scatter density 0.1" in said and "reached 0.1 after" in said and "differ in the resin from the job by" in said
    )
    assert 240 < len(read_run(run).shown) < 1200 and (run / "report.html").stat().st_size > 10_000

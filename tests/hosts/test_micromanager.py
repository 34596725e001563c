"""Stages and cameras of Micro-Manager, on devices of its core that are written in Python."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vamgpu.errors import BadInput, DeviceError, DeviceLost, DeviceNotFound, DeviceRefused, WrongDevice
from vamgpu.hosts.drivers.camera import CameraDriver
from vamgpu.hosts.drivers.micromanager import MicroManagerCamera, MicroManagerStage, open_core
from vamgpu.hosts.drivers.stages import Stage

unicore = pytest.importorskip("pymmcore_plus.experimental.unicore", reason='pip install "vamgpu[micromanager]"')


class _Stage(unicore.StageDevice):
    """Moves at once, and is busy for a few looks after."""

    at_um, looks, dead = 500.0, 0, False

    def busy(self) -> bool:
        self.looks -= 1
        return self.looks >= 0

    def home(self) -> None:
        self.at_um, self.looks = 0.0, 3

    def stop(self) -> None:
        self.looks = 0

    def set_origin(self) -> None: ...

    def set_position_um(self, val: float) -> None:
        if val > 50_000:
            raise ValueError("beyond the limit")
        self.at_um, self.looks = val, 3

    def get_position_um(self) -> float:
        if self.dead:
            raise OSError("no answer")
        return self.at_um


class _Camera(unicore.SimpleCameraDevice):
    """Shows its exposure [ms] as gray level, at most 100."""

    exposure = 10.0

    def get_exposure(self) -> float:
        return self.exposure

    def set_exposure(self, exposure: float) -> None:
        self.exposure = min(exposure, 100.0)

    def sensor_shape(self) -> tuple[int, int]:
        return (4, 6)

    def dtype(self) -> type:
        return np.uint8

    def snap(self, buffer: np.ndarray) -> Mapping[str, Any]:
        buffer[:] = round(self.exposure)
        return {}


@pytest.fixture
def stage_device() -> _Stage:
    return _Stage()


@pytest.fixture
def core(stage_device: _Stage) -> Iterator[Any]:
    found = unicore.UniMMCore()
    found.loadPyDevice("Z", stage_device)
    found.loadPyDevice("Cam", _Camera())
    found.initializeAllDevices()
    yield found
    found.unloadAllDevices()


def test_the_stage_goes_to_places(core: Any) -> None:
    pauses: list[float] = []
    with MicroManagerStage(core, "Z", pause=pauses.append) as stage:
        assert isinstance(stage, Stage) and stage.unit == "mm" and stage.position() == 0.5
        stage.move(12.5, 1.0)
        stage.wait()
        assert stage.position() == 12.5 and len(pauses) == 3
        stage.run(0)
        with pytest.raises(DeviceRefused, match="only moves to positions"):
            stage.run(2.0)
        with pytest.raises(DeviceRefused, match="beyond the limit"):
            stage.move(60.0, 1.0)
        with pytest.raises(BadInput):
            stage.move(1.0, 0.0)


def test_the_stage_that_fails_is_told(core: Any, stage_device: _Stage) -> None:
    stage = MicroManagerStage(core, "Z", patience_s=0.1, pause=lambda seconds: None)
    stage_device.looks = 10**6
    with pytest.raises(DeviceError, match="still moves"):
        stage.wait()
    stage_device.dead = True
    with pytest.raises(DeviceLost, match="no answer"):
        stage.position()
    with pytest.raises(WrongDevice, match="CameraDevice"):
        MicroManagerStage(core, "Cam")
    with pytest.raises(DeviceNotFound, match="Z, Cam"):
        MicroManagerStage(core, "X")


def test_the_camera(core: Any) -> None:
    with MicroManagerCamera(core, "Cam") as camera:
        assert isinstance(camera, CameraDriver)
        camera.expose(42_000)
        assert camera.grab().shape == (4, 6) and (camera.grab() == 42).all()
        with pytest.raises(DeviceRefused, match="100000 us"):
            camera.expose(200_000)


def test_a_camera_that_the_core_does_not_take_is_let_go_of(core: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(core, "setCameraDevice", None)
    with pytest.raises(DeviceRefused, match="setCameraDevice"):
        MicroManagerCamera(core, "Cam", owned=True)
    assert "Cam" not in core.getLoadedDevices()


def test_a_configuration_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(DeviceNotFound, match="wizard"):
        open_core(tmp_path / "none.cfg")
    (tmp_path / "wrong.cfg").write_text("Device,Z,NoSuchAdapter,Stage\n")
    with pytest.raises(DeviceNotFound, match="mmcore install"):
        open_core(tmp_path / "wrong.cfg")

"""Cameras of Micro-Manager, on a device of its core that is written in Python."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vamgpu.errors import DeviceNotFound, DeviceRefused, WrongDevice
from vamgpu.hosts.drivers.camera import CameraDriver
from vamgpu.hosts.drivers.micromanager import MicroManagerCamera, open_core

unicore = pytest.importorskip("pymmcore_plus.experimental.unicore", reason='pip install "vamgpu[micromanager]"')


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
def core() -> Iterator[Any]:
    found = unicore.UniMMCore()
    found.loadPyDevice("Cam", _Camera())
    found.initializeAllDevices()
    yield found
    found.unloadAllDevices()


def test_a_label_of_no_camera_is_told(core: Any) -> None:
    with pytest.raises(DeviceNotFound, match="'Z' among Cam"):
        MicroManagerCamera(core, "Z")
    with pytest.raises(WrongDevice, match="CoreDevice"):
        MicroManagerCamera(core, "Core")


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

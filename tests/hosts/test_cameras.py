"""Cameras through a maker's producer."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from vamgpu.errors import DeviceLost, DeviceNotFound, DeviceRefused
from vamgpu.hosts.drivers.camera import CameraDriver, GenicamCamera
from vamgpu.hosts.emulators.camera import EmulatedCamera
from vamgpu.hosts.emulators.clock import VirtualClock


class _Node:
    """A feature as a camera keeps it: limited, in steps, or one of its choices."""

    def __init__(self, value: object, greatest: float = 0.0, step: float = 0.0, choices: tuple[str, ...] = ()) -> None:
        self._value, self._greatest, self._step, self._choices = value, greatest, step, choices

    @property
    def value(self) -> object:
        return self._value

    @value.setter
    def value(self, value: object) -> None:
        if self._choices and value not in self._choices:
            raise ValueError(f"{value} is not available")
        if isinstance(value, float):
            value = min(value, self._greatest)
            value = round(value / self._step) * self._step if self._step else value
        self._value = value


class _Harvester:
    """What of a harvester the driver calls."""

    def __init__(self, serials: list[str]) -> None:
        self.device_info_list = [SimpleNamespace(serial_number=serial) for serial in serials]
        self.log: list[str] = []
        self.exposure = _Node(0.0, greatest=5000.0)
        self.nodes = SimpleNamespace(
            ExposureTime=self.exposure,
            ExposureAuto=_Node("Continuous", choices=("Off", "Continuous")),
            Gain=_Node(0.0, greatest=24.0, step=0.1),
            PixelFormat=_Node("Mono8", choices=("Mono8", "Mono12")),
            TriggerSelector=_Node("FrameStart", choices=("FrameStart",)),
            TriggerSource=_Node("Software", choices=("Software", "Line0")),
            TriggerMode=_Node("Off", choices=("On", "Off")),
        )

    def update(self) -> None:
        self.log.append("update")

    def create(self, chosen: dict[str, str]) -> _Harvester:
        self.log.append(f"create {chosen['serial_number']}")
        return self

    def start(self) -> None:
        self.log.append("start")

    def stop(self) -> None:
        self.log.append("stop")

    def destroy(self) -> None:
        self.log.append("destroy")

    def reset(self) -> None:
        self.log.append("reset")

    @property
    def remote_device(self) -> SimpleNamespace:
        return SimpleNamespace(node_map=self.nodes)

    def fetch(self, timeout: float) -> _Harvester:
        if timeout < 1:
            raise TimeoutError("no image")
        return self

    def __enter__(self) -> SimpleNamespace:
        part = SimpleNamespace(data=np.arange(6, dtype=np.uint8), height=2, width=3)
        return SimpleNamespace(payload=SimpleNamespace(components=[part]))

    def __exit__(self, *_: object) -> None:
        self.log.append("queue")


def test_the_genicam_camera() -> None:
    harvester = _Harvester(["A1", "B2"])
    with GenicamCamera(harvester, "B2") as camera:
        assert isinstance(camera, CameraDriver)
        camera.expose(1500)
        assert harvester.exposure.value == 1500.0
        assert camera.grab().tolist() == [[0, 1, 2], [3, 4, 5]]
    assert harvester.log == ["update", "create B2", "start", "queue", "stop", "destroy", "reset"]
    with pytest.raises(DeviceNotFound, match="A1, B2"):
        GenicamCamera(_Harvester(["A1", "B2"]), "C3")
    with pytest.raises(DeviceLost, match="no image"):
        GenicamCamera(_Harvester(["A1"]), timeout_s=0.5).grab()


def test_the_genicam_cameras_settings_are_read_back() -> None:
    harvester = _Harvester(["A1"])
    with GenicamCamera(harvester, exposure_us=1500, gain=6.02, pixels="Mono12", trigger="Line0") as camera:
        assert camera.exposure_us == 1500.0 and camera.gain == pytest.approx(6.0)
        values = {name: node.value for name, node in vars(harvester.nodes).items()}
        assert values["ExposureAuto"] == "Off" and values["PixelFormat"] == "Mono12"
        assert (values["TriggerSource"], values["TriggerMode"]) == ("Line0", "On")
        with pytest.raises(DeviceRefused, match="ExposureTime is 5000"):
            camera.expose(9000)
    with GenicamCamera(harvester, trigger=""):
        assert harvester.nodes.TriggerMode.value == "Off"
    refused: tuple[tuple[dict[str, Any], str], ...] = (
        ({"pixels": "RGB8"}, "PixelFormat"),
        ({"gain": 40.0}, "Gain"),
        ({"trigger": "Line9"}, "Line9"),
    )
    for setting, told in refused:
        refusing = _Harvester(["A1"])
        with pytest.raises(DeviceRefused, match=told):
            GenicamCamera(refusing, **setting)
        assert refusing.log[-2:] == ["destroy", "reset"] and "start" not in refusing.log


def test_the_emulated_camera_is_a_camera() -> None:
    assert isinstance(EmulatedCamera(VirtualClock(), lambda now: np.zeros((2, 2))), CameraDriver)

"""Cameras: through a maker's producer, and from files."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from vamgpu.errors import DeviceError, DeviceLost, DeviceNotFound
from vamgpu.hosts.drivers.camera import Camera, FilePlayer, GenicamCamera
from vamgpu.hosts.emulators.camera import EmulatedCamera
from vamgpu.hosts.emulators.clock import VirtualClock


class _Harvester:
    """What of a harvester the driver calls."""

    def __init__(self, serials: list[str]) -> None:
        self.device_info_list = [SimpleNamespace(serial_number=serial) for serial in serials]
        self.log: list[str] = []
        self.exposure = SimpleNamespace(value=0.0)

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
        return SimpleNamespace(node_map=SimpleNamespace(ExposureTime=self.exposure))

    def fetch(self, timeout: float) -> _Harvester:
        if timeout < 1:
            raise TimeoutError("no picture")
        return self

    def __enter__(self) -> SimpleNamespace:
        part = SimpleNamespace(data=np.arange(6, dtype=np.uint8), height=2, width=3)
        return SimpleNamespace(payload=SimpleNamespace(components=[part]))

    def __exit__(self, *_: object) -> None:
        self.log.append("queue")


def test_the_genicam_camera() -> None:
    harvester = _Harvester(["A1", "B2"])
    with GenicamCamera(harvester, "B2") as camera:
        assert isinstance(camera, Camera)
        camera.expose(1500)
        assert harvester.exposure.value == 1500.0
        assert camera.grab().tolist() == [[0, 1, 2], [3, 4, 5]]
    assert harvester.log == ["update", "create B2", "start", "queue", "stop", "destroy", "reset"]
    with pytest.raises(DeviceNotFound, match="A1, B2"):
        GenicamCamera(_Harvester(["A1", "B2"]), "C3")
    with pytest.raises(DeviceLost, match="no picture"):
        GenicamCamera(_Harvester(["A1"]), timeout_s=0.5).grab()


def test_the_file_player_counts_as_people_do(tmp_path: Path) -> None:
    for number in (1, 2, 10):
        Image.fromarray(np.full((2, 3), number, np.uint8)).save(tmp_path / f"shot{number}.png")
    (tmp_path / "notes.txt").write_text("not a picture")
    player = FilePlayer(tmp_path)
    assert isinstance(player, Camera)
    assert [int(player.grab()[0, 0]) for _ in range(3)] == [1, 2, 10]
    with pytest.raises(DeviceError, match="all 3"):
        player.grab()
    again = FilePlayer(tmp_path, loop=True)
    assert [int(again.grab()[0, 0]) for _ in range(4)] == [1, 2, 10, 1]
    with pytest.raises(DeviceNotFound):
        FilePlayer(tmp_path / "none")
    assert isinstance(EmulatedCamera(VirtualClock(), lambda now: np.zeros((2, 2))), Camera)

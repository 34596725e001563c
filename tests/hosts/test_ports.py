"""Ports: machines that are missing, taken, or other than they should be; and packages that are not there."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from servers import PtyServer
from tcp_server import TcpServer

import vamgpu
from vamgpu.errors import BadInput, DeviceBusy, DeviceNotFound, WrongDevice
from vamgpu.hosts.drivers.camera import GenicamCamera
from vamgpu.hosts.drivers.controller import Controller
from vamgpu.hosts.drivers.dmd import Dmd
from vamgpu.hosts.drivers.lens import LensDriver
from vamgpu.hosts.drivers.projector import PygletWindow
from vamgpu.hosts.drivers.scpi import PowerMeter
from vamgpu.hosts.drivers.stages import StandaStage, ZaberStage
from vamgpu.hosts.drivers.wire import open_wire
from vamgpu.hosts.emulators.controller import EmulatedController
from vamgpu.hosts.emulators.lens import EmulatedLens


def test_a_missing_machine_is_an_error_that_says_what_to_check() -> None:
    for open_it in (
        lambda: LensDriver.open("/dev/no-such-port"),
        lambda: Controller.open("/dev/no-such-port"),
        lambda: ZaberStage.open("socket://127.0.0.1:1", 100.0),
        lambda: PowerMeter.open("usbtmc:/dev/no-such-meter"),
    ):
        with pytest.raises(DeviceNotFound, match="check"):
            open_it()
    with pytest.raises(DeviceNotFound, match="ALP library"):
        Dmd.open("/no/such/library.so")
    with pytest.raises(BadInput, match="address"):
        open_wire("nonsense://x", "a machine")


def test_a_port_has_one_user() -> None:
    with PtyServer(EmulatedController()) as server:
        first = Controller.open(server.url)
        with pytest.raises(DeviceBusy, match="another program"):
            Controller.open(server.url)
        first.close()
        Controller.open(server.url).close()


def test_another_machine_on_the_port_is_told() -> None:
    with PtyServer(EmulatedController()) as server, pytest.raises(WrongDevice):
        LensDriver.open(server.url, timeout_s=0.05)
    with PtyServer(EmulatedLens()) as server, pytest.raises(WrongDevice):
        Controller.open(server.url, timeout_s=0.05)
    with TcpServer(EmulatedLens()) as server, pytest.raises(WrongDevice):
        ZaberStage.open(server.url, 100.0, timeout_s=0.1)


def test_no_driver_imports_what_it_does_not_use() -> None:
    code = (
        "import sys, pkgutil, importlib, vamgpu.hosts.drivers as d\n"
        "for m in pkgutil.iter_modules(d.__path__): importlib.import_module(d.__name__ + '.' + m.name)\n"
        "bad = {'serial', 'pyglet', 'harvesters', 'libximc', 'zaber_motion', 'pyvisa', 'pymmcore_plus', 'hid'}\n"
        "bad = (bad | {'vamgpu.hosts.emulators'}) & set(sys.modules)\n"
        "sys.exit(', '.join(bad) or 0)\n"
    )
    environment = os.environ | {"PYTHONPATH": str(Path(vamgpu.__file__).parents[1])}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_packages_that_are_not_there_are_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name in ("pyglet", "harvesters", "harvesters.core", "libximc", "serial"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(DeviceNotFound, match=r"vamgpu\[window\]"):
        PygletWindow(1, (1080, 1920))
    with pytest.raises(DeviceNotFound, match=r"vamgpu\[camera\]"):
        GenicamCamera.open(tmp_path / "x.cti")
    with pytest.raises(DeviceNotFound, match=r"vamgpu\[standa\]"):
        StandaStage.open("xi-com:///dev/ttyACM0", 80.0)
    with pytest.raises(DeviceNotFound, match=r"vamgpu\[hardware\]"):
        open_wire("/dev/ttyUSB0", "a machine")

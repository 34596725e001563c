"""The stages' drivers against an emulated stage, and a maker's axis that remembers its calls."""

from __future__ import annotations

import time
from types import SimpleNamespace

import pytest

from vamgpu.errors import BadInput, DeviceRefused
from vamgpu.hosts.drivers.stage import Stage
from vamgpu.hosts.drivers.standa import StandaStage
from vamgpu.hosts.drivers.wire import Wire
from vamgpu.hosts.drivers.zaber import ZaberStage
from vamgpu.hosts.emulators.clock import VirtualClock
from vamgpu.hosts.emulators.line import Faults, LineMachine
from vamgpu.hosts.emulators.ports import plug
from vamgpu.hosts.emulators.servers import TcpServer
from vamgpu.hosts.emulators.stage import EmulatedStage

SECOND = 1_000_000_000


def _wire(machine: LineMachine, clock: VirtualClock, faults: Faults | None = None, timeout_s: float = 0.1) -> Wire:
    return Wire(plug(machine, clock, timeout_s, faults=faults), "the machine")


def test_the_zaber_stage_over_a_socket() -> None:
    machine = EmulatedStage(rotary=True, acceleration=3_000_000.0)
    with TcpServer(machine) as server, ZaberStage.open(server.url, microsteps=1000.0) as stage:
        assert isinstance(stage, Stage)
        stage.move(36.0, 600.0)
        assert stage.busy()
        stage.wait()
        assert stage.position() == 36.0
        stage.run(40.0)
        time.sleep(0.1)
        stage.stop()
        stage.wait()
        assert stage.position() > 38.0
        with pytest.raises(DeviceRefused, match="BADCOMMAND"):
            stage.ask("dance")
        assert stage.true_speed(40.0) == pytest.approx(40.0, abs=1e-3)


def test_the_zaber_stage_stays_within_its_limits() -> None:
    clock = VirtualClock()
    machine = EmulatedStage(limit=100_000)
    stage = ZaberStage(_wire(machine, clock), 1000.0, "mm", pause=lambda s: clock.sleep(round(s * SECOND)))
    stage.home()
    with pytest.raises(DeviceRefused, match="BADDATA"):
        stage.move(200.0, 10.0)
    stage.move(50.0, 10.0)
    stage.wait()
    assert 5 * SECOND < clock.now() < 6 * SECOND and machine.true_position(clock.now()) == 50_000
    with pytest.raises(BadInput):
        ZaberStage(_wire(machine, clock), 0.0)


class _Ximc:
    """What of the maker's axis the driver calls."""

    def __init__(self) -> None:
        self.calls: list[tuple[object, ...]] = []
        self.settings = SimpleNamespace(Speed=0, uSpeed=0)

    def __getattr__(self, name: str) -> object:
        def called(*arguments: object) -> object:
            self.calls.append((name, *arguments))
            if name == "get_move_settings":
                return self.settings
            if name == "get_position":
                return SimpleNamespace(Position=-12, uPosition=-128)
            return None

        return called


def test_the_standa_stage_counts_in_steps_and_fractions() -> None:
    axis = _Ximc()
    with StandaStage(axis, steps=80.0) as stage:
        assert isinstance(stage, Stage)
        assert stage.position() == pytest.approx(-12.5 / 80)
        stage.move(-1.00625, 2.003125)
        assert axis.calls[-1] == ("command_move", -80, -128)
        assert (axis.settings.Speed, axis.settings.uSpeed) == (160, 64)
        stage.run(-1.0)
        assert axis.calls[-1] == ("command_left",)
    assert axis.calls[-2:] == [("command_sstp",), ("close_device",)]

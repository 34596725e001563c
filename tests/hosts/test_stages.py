"""The stages' drivers against an emulated stage, and a maker's axis that remembers its calls."""

from __future__ import annotations

import time
from pathlib import Path
from types import SimpleNamespace

import pytest
from tcp_server import TcpServer

from vamgpu.errors import BadInput, DeviceLost, DeviceNotFound, DeviceRefused
from vamgpu.hosts.drivers.stages import Stage, StandaStage, ZaberStage
from vamgpu.hosts.drivers.wire import Wire
from vamgpu.hosts.emulators.clock import VirtualClock
from vamgpu.hosts.emulators.line import Faults, LineDevice, VirtualPort
from vamgpu.hosts.emulators.stage import EmulatedStage

SECOND = 1_000_000_000


def _wire(machine: LineDevice, clock: VirtualClock, faults: Faults | None = None, timeout_s: float = 0.1) -> Wire:
    return Wire(VirtualPort(machine, clock, timeout_s, faults=faults), "the machine")


def test_the_zaber_stage_over_a_socket() -> None:
    machine = EmulatedStage(rotary=True, acceleration=3_000_000.0)
    with TcpServer(machine) as server, ZaberStage.open(server.url, microsteps=1000.0) as stage:
        assert isinstance(stage, Stage)
        stage.move(36.0, 36.0)
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


def test_the_zaber_stage_stays_within_its_limits() -> None:
    clock = VirtualClock()
    machine = EmulatedStage(limit=100_000)
    stage = ZaberStage(_wire(machine, clock), 1000.0, "mm", pause=lambda s: clock.sleep(round(s * SECOND)))
    with pytest.raises(DeviceRefused, match="BADDATA"):
        stage.move(200.0, 10.0)
    stage.move(50.0, 10.0)
    stage.wait()
    assert 5 * SECOND < clock.now() < 6 * SECOND and machine.true_position(clock.now()) == 50_000
    with pytest.raises(BadInput):
        ZaberStage(_wire(machine, clock), 0.0)


def test_the_zaber_stage_gives_an_edge_each_pose() -> None:
    clock, machine = VirtualClock(), EmulatedStage(rotary=True, acceleration=1e9)
    stage = ZaberStage(_wire(machine, clock), 1000.0)
    stage.trigger_every(3.0)
    assert machine.edges == 0
    stage.run(30.0)
    clock.sleep(SECOND)
    assert machine.edges == 10
    stage.trigger_every(0)
    assert machine.edges == 0
    with pytest.raises(BadInput, match="drifts"):
        stage.trigger_every(1.0015)
    with pytest.raises(BadInput, match="two microsteps"):
        stage.trigger_every(0.0001)
    stage.close()
    with pytest.raises(DeviceRefused, match="BADDATA"):
        ZaberStage(_wire(machine, clock), 1000.0, output=7).trigger_every(3.0)


def test_any_output_triggers_and_another_gates_it() -> None:
    clock, machine = VirtualClock(), EmulatedStage(rotary=True, acceleration=1e9, wired=2, joined=1)
    heard: list[bytes] = []
    receive = machine.receive

    def record(data: bytes, now: int) -> None:
        heard.append(data[1:].split(b":")[0].split(b" ", 3)[3])
        receive(data, now)

    machine.receive = record
    stage = ZaberStage(_wire(machine, clock), 1000.0, output=2, gate=1)
    heard.clear()
    stage.trigger_every(3.0)
    assert heard == [
        b"trigger 2 disable", b"io set do 2 0", b"io set do 1 1", b"trigger 2 when 1 dist 1500",
        b"trigger 2 action a io set do 2 t", b"trigger 2 enable",
    ]  # fmt: skip
    stage.run(30.0)
    clock.sleep(SECOND)
    assert machine.edges == 10 and 1 in machine.levels
    heard.clear()
    stage.trigger_every(0.0)
    assert heard == [b"trigger 2 disable", b"io set do 2 0", b"io set do 1 0"] and not machine.levels
    stage.close()
    wrong = ZaberStage(_wire(machine, clock), 1000.0, output=2)
    wrong.trigger_every(3.0)
    wrong.run(30.0)
    clock.sleep(SECOND)
    assert not machine.edges, "the board passes no edge while output 1 is low"


def test_a_zaber_stage_that_is_unplugged_is_lost() -> None:
    with TcpServer(EmulatedStage(rotary=True)) as server:
        stage = ZaberStage.open(server.url, 1000.0, timeout_s=0.2)
        server.faults.dead = True
        with pytest.raises(DeviceLost, match="get pos"):
            stage.position()
        server.close()
        with pytest.raises(DeviceLost):
            stage.run(10.0)
        stage.close()
    with pytest.raises(BadInput, match="socket"):
        ZaberStage.open("socket://nowhere", 1000.0)


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


def test_the_standa_stage_on_the_makers_virtual_axis(tmp_path: Path) -> None:
    with StandaStage.open(f"xi-emu://{tmp_path / 'axis.bin'}", steps=80.0) as stage:
        start = stage.position()
        stage.move(start + 2.5, 20.0)
        stage.wait()
        assert stage.position() == pytest.approx(start + 2.5, abs=1 / 80 / 256)
        stage.run(5.0)
        time.sleep(0.1)
        stage.run(0)
        stage.wait()
        assert stage.position() > start + 2.5
    stage.close()
    with pytest.raises(DeviceNotFound, match="check address"):
        StandaStage.open("xi-com:///dev/no-such-axis", steps=80.0)

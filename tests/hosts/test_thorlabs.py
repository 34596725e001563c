"""Thorlabs's motion cubes: their messages to the byte, and what they do when they fail."""

from __future__ import annotations

import pytest
from emulated_cube import EmulatedCube
from servers import PtyServer

from vamgpu.errors import BadInput, DeviceError, DeviceLost, WrongDevice
from vamgpu.hosts.drivers.stages import Stage
from vamgpu.hosts.drivers.thorlabs import ThorlabsStage
from vamgpu.hosts.drivers.wire import Wire
from vamgpu.hosts.emulators.clock import VirtualClock
from vamgpu.hosts.emulators.line import Faults, VirtualPort
from vamgpu.hosts.rigs.config import parse_rig

pytest.importorskip("thorlabs_apt_protocol", reason='pip install "vamgpu[thorlabs]"')
SECOND = 1_000_000_000
COUNTS = 1919.6418578623391  # of a degree, on a PRM1-Z8


def stage_of(
    machine: EmulatedCube,
    clock: VirtualClock,
    counts: float = COUNTS,
    faults: Faults | None = None,
    patience: float = 60.0,
) -> ThorlabsStage:
    wire = Wire(VirtualPort(machine, clock, 0.1, faults=faults), "the cube")
    return ThorlabsStage(wire, counts, patience_s=patience, pause=lambda s: clock.sleep(round(s * SECOND)))


def test_messages_to_the_byte() -> None:
    clock, cube = VirtualClock(), EmulatedCube()
    stage = stage_of(cube, clock)
    assert cube.received == [bytes.fromhex("05 00 00 00 50 01"), bytes.fromhex("10 02 01 01 50 01")] and cube.enabled
    cube.received.clear()
    stage.move(10.0, 24.0)
    assert cube.received == [
        bytes.fromhex("14 04 01 00 50 01"),
        bytes.fromhex("13 04 0e 00 d0 01 01 00 00 00 00 00 e8 03 00 00")
        + round(24 * COUNTS * 22.369621333333).to_bytes(4, "little"),
        bytes.fromhex("53 04 06 00 d0 01 01 00") + round(10 * COUNTS).to_bytes(4, "little"),
    ]
    stage.wait()
    assert stage.position() == pytest.approx(10.0, abs=1 / COUNTS)
    cube.received.clear()
    stage.run(-5.0)
    stage.stop()
    assert cube.received[-2:] == [bytes.fromhex("57 04 01 02 50 01"), bytes.fromhex("65 04 01 02 50 01")]


def test_it_turns_at_its_speed_and_finds_its_zero() -> None:
    for cube in (EmulatedCube(), EmulatedCube("KST101", 53.6870912, stepper=True)):
        clock = VirtualClock()
        stage = stage_of(cube, clock)
        assert isinstance(stage, Stage)
        stage.run(20.0)
        clock.sleep(SECOND)
        before, began = stage.position(), clock.now()
        clock.sleep(2 * SECOND)
        assert (stage.position() - before) / (clock.now() - began) * SECOND == pytest.approx(20.0, rel=1e-3)
        assert stage.busy()
        stage.run(0.0)
        stage.wait()
        assert not stage.busy()
        stage.close()


def test_a_move_is_over_when_the_cube_says_so() -> None:
    clock = VirtualClock()
    stage = stage_of(EmulatedCube(slow=SECOND // 10), clock)
    stage.move(10.0, 24.0)
    stage.wait()
    assert stage.position() == pytest.approx(10.0, abs=1 / COUNTS), "a status that says late that it moves"


def test_what_fails_is_told() -> None:
    clock = VirtualClock()
    with pytest.raises(WrongDevice, match="is a BSC203; expected a motion cube"):
        stage_of(EmulatedCube("BSC203"), clock)
    with pytest.raises(WrongDevice, match="does not answer as a Thorlabs cube"):
        stage_of(EmulatedCube(), clock, faults=Faults(dead=True))
    with pytest.raises(BadInput, match="are impossible"):
        stage_of(EmulatedCube(), clock, counts=0.0)
    faults, cube = Faults(), EmulatedCube()
    stage = stage_of(cube, clock, faults=faults, patience=0.1)
    for position, speed in ((1.0, 0.0), (1e9, 1.0), (1.0, 1e9), (1.0, 1e-9)):
        with pytest.raises(BadInput):
            stage.move(position, speed)
    stage.move(90.0, 10.0)
    with pytest.raises(DeviceError, match="still moves"):
        stage.wait()
    faults.dead = True
    with pytest.raises(DeviceLost, match="check its power"):
        stage.position()


def test_a_rig_opens_it() -> None:
    with PtyServer(EmulatedCube()) as server:
        rig = parse_rig(
            '[rig]\nname = "lab"\nmachine = "vial"\n[display]\ndriver = "video"\n'
            f'[motion]\ndriver = "thorlabs"\nport = "{server.url}"\nmicrosteps = {COUNTS}\n'
        )
        opened = rig.setup.motion.open("deg")
        assert isinstance(opened, ThorlabsStage)
        with opened as stage:
            assert (stage.kind, stage.unit, stage.position()) == ("KDC101", "deg", 0.0)

"""Steppers on boards: Pololu's Tic, a TMC2209, GRBL and a lab's firmware, to the byte, and what fails."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from emulated_steppers import EmulatedFirmware, EmulatedGrbl, EmulatedTic, EmulatedTmc2209
from servers import PtyServer

from vamgpu.errors import BadInput, DeviceError, DeviceLost, DeviceRefused, JobError, ProtocolError, WrongDevice
from vamgpu.hosts.drivers import tmc2209
from vamgpu.hosts.drivers.stages import PolledStage, Stage
from vamgpu.hosts.drivers.text_stage import Dialogue, GrblStage, TextStage, grbl
from vamgpu.hosts.drivers.tic import TicStage
from vamgpu.hosts.drivers.tmc2209 import Tmc2209Stage
from vamgpu.hosts.drivers.wire import Wire
from vamgpu.hosts.emulators.clock import VirtualClock
from vamgpu.hosts.emulators.line import Faults, VirtualPort
from vamgpu.hosts.rigs.config import parse_rig

ticlib: Any = pytest.importorskip("ticlib", reason='pip install "vamgpu[tic]"')
SECOND = 1_000_000_000
TURN = 3200.0 / 360.0
OWN = Dialogue("P\n", r"^pos (?P<steps>-?\d+)$", "V {steps_per_s:.2f}\n", "S\n", accepted="^done$")


def tic_of(machine: EmulatedTic, clock: VirtualClock, faults: Faults | None = None) -> TicStage:
    wire = Wire(VirtualPort(machine, clock, 0.1, faults=faults), "the Tic")
    return TicStage(ticlib.TicSerial(wire.port), wire, "the Tic", TURN, pause=pause(clock))


def tmc_of(machine: EmulatedTmc2209, clock: VirtualClock, faults: Faults | None = None) -> Tmc2209Stage:
    wire = Wire(VirtualPort(machine, clock, 0.02, 115200, faults), "the TMC2209")
    return Tmc2209Stage(wire, 51200 / 360, clock=clock, pause=pause(clock))


def grbl_of(machine: EmulatedGrbl, clock: VirtualClock, microsteps: float = 80.0) -> GrblStage:
    wire = Wire(VirtualPort(machine, clock, 0.1), "the board")
    return GrblStage(wire, grbl("XYZ"[machine.axis]), microsteps, pause=pause(clock))


def own_of(machine: EmulatedFirmware, clock: VirtualClock, says: Dialogue = OWN) -> TextStage:
    return TextStage(Wire(VirtualPort(machine, clock, 0.1), "the board"), says, TURN, pause=pause(clock))


def pause(clock: VirtualClock) -> Callable[[float], None]:
    return lambda seconds: clock.sleep(round(seconds * SECOND))


ALL: dict[str, tuple[Any, Any, float]] = {
    "tic": (EmulatedTic, tic_of, TURN), "tmc2209": (EmulatedTmc2209, tmc_of, 51200 / 360),
    "grbl": (EmulatedGrbl, grbl_of, 1.0), "own": (EmulatedFirmware, own_of, TURN),
}  # fmt: skip


@pytest.mark.parametrize("name", ALL)
def test_each_turns_at_its_speed_goes_to_places_and_stops(name: str) -> None:
    board, opened, per_degree = ALL[name]
    clock = VirtualClock()
    machine = board()
    stage = opened(machine, clock)
    assert isinstance(stage, Stage) and isinstance(stage, PolledStage)
    for speed in (6.0, 60.0, -20.0):  # what a tabletop printer turns at, and backwards
        stage.run(speed)
        for _ in range(60):
            clock.sleep(SECOND // 60)
            stage.position()
        before, began = machine.track.position(clock.now()), clock.now()
        reported = stage.position()
        for _ in range(120):
            clock.sleep(SECOND // 60)
            stage.position()
        seconds = (clock.now() - began) / SECOND
        assert (machine.track.position(clock.now()) - before) / seconds == pytest.approx(speed * per_degree, rel=1e-3)
        assert stage.position() - reported == pytest.approx(speed * seconds, rel=5e-3), "what it reports"
        assert stage.busy()
    stage.run(0.0)
    stage.wait()
    assert not machine.track.moving(clock.now()) and not stage.busy()
    stage.move(stage.position() + 30.0, 20.0)
    stage.wait()
    true = machine.track.position(clock.now()) / per_degree
    assert not machine.track.moving(clock.now())
    assert stage.position() % (360 * 1024 / 51200) == pytest.approx(true % (360 * 1024 / 51200), abs=0.15)
    with pytest.raises(BadInput, match="above 0"):
        stage.move(90.0, 0.0)
    stage.run(20.0)
    clock.sleep(SECOND // 4)
    stage.close()
    clock.sleep(SECOND)
    assert not machine.track.moving(clock.now()), "closed, it stops"


def test_the_tic_to_the_byte() -> None:
    clock, machine = VirtualClock(), EmulatedTic()
    stage = tic_of(machine, clock)
    assert machine.received == [b"\xa8\x01\x01", b"\xa1\x16\x04", b"\x85", b"\x83", b"\x8c", b"\xa1\x02\x02"]
    machine.received.clear()
    stage.run(-40.0)
    speed = round(-40.0 * TURN * 10_000)  # -3,555,556 = 0xffc9bf1c; the top bits of its bytes go first
    assert speed & 0xFFFFFFFF == 0xFFC9BF1C
    assert machine.received[-1] == bytes.fromhex("e3 0e 1c 3f 49 7f")
    machine.received.clear()
    stage.position()
    assert machine.received == [b"\x8c", b"\xa1\x22\x04"]
    stage.close()
    assert machine.received[-1] == b"\x86"


def test_a_tic_whose_host_is_silent_stops() -> None:
    clock, machine = VirtualClock(), EmulatedTic()
    stage = tic_of(machine, clock)
    stage.run(40.0)
    clock.sleep(3 * SECOND)
    assert not machine.track.moving(clock.now())
    with pytest.raises(DeviceRefused, match="command timeout"):
        machine._fed = -(10**12)
        machine.errors |= 1 << 6
        stage._checked()


def test_what_a_tic_does_not_do_is_told() -> None:
    with pytest.raises(DeviceRefused, match="Serial/I2C/USB"):
        tic_of(EmulatedTic(control_mode=1), VirtualClock())
    with pytest.raises(DeviceRefused, match="low supply voltage"):
        tic_of(EmulatedTic(errors=0b100), VirtualClock())
    clock = VirtualClock()
    stage = tic_of(EmulatedTic(most=2_000_000), clock)
    with pytest.raises(BadInput, match=r"allows 22\.5: go slower"):
        stage.run(40.0)
    stage.move(10.0, 20.0)
    stage.wait()
    stage.run(22.0)
    with pytest.raises(BadInput, match="counts to"):
        stage.move(1e9, 20.0)
    stage._line.port.unplug()  # type: ignore[attr-defined]
    with pytest.raises(DeviceLost, match="check its plug"):
        stage.position()
    stage.close()


def test_the_tmc2209_to_the_byte() -> None:
    assert tmc2209.datagram(0, 0x00) == bytes.fromhex("05 00 00 48")
    assert tmc2209.datagram(0, 0x02) == bytes.fromhex("05 00 02 8f")
    clock, machine = VirtualClock(), EmulatedTmc2209()
    stage = tmc_of(machine, clock)
    assert machine.registers[0x00] == 0x1C1 and machine.registers[0x6C] == 0x1000_0053, "256 microsteps, by UART"
    stage.run(40.0)
    value = round(40.0 * 51200 / 360 * 2**24 / 12e6)
    assert machine.received[-2][:7] == bytes.fromhex("05 00 a2 00") + value.to_bytes(3, "big")
    stage.run(-40.0)
    assert machine.received[-2][3:7] == bytes(1) + (2**24 - value).to_bytes(3, "big")


@pytest.mark.parametrize("fast", (0.96, 1.04))
def test_a_tmc2209_reports_and_corrects_what_its_own_clock_makes_of_a_speed(fast: float) -> None:
    clock, machine = VirtualClock(), EmulatedTmc2209(fast=fast, echo=False)
    stage = tmc_of(machine, clock)
    stage.run(60.0)
    for _ in range(600):
        clock.sleep(SECOND // 60)
        stage.position()
    speed = machine.track.velocity(clock.now()) / 51200 * 360
    assert speed == pytest.approx(60.0, rel=1e-3)
    assert stage.position() == pytest.approx(machine.track.position(clock.now()) / 51200 * 360, abs=0.05)


def test_what_a_tmc2209_does_not_take_is_told() -> None:
    clock = VirtualClock()
    with pytest.raises(WrongDevice, match="0x20; expected a TMC2209"):
        tmc_of(EmulatedTmc2209(version=0x20), clock)
    with pytest.raises(WrongDevice, match="does not answer"):
        tmc_of(EmulatedTmc2209(node=2), clock)
    with pytest.raises(DeviceRefused, match="did not take"):
        tmc_of(EmulatedTmc2209(deaf=True), clock)
    stage = tmc_of(EmulatedTmc2209(), clock)
    with pytest.raises(BadInput, match="too fast"):
        stage.run(1e6)
    flipped = tmc_of(EmulatedTmc2209(), clock)
    flipped._wire.port.faults.flip_out = frozenset(range(10_000))  # type: ignore[attr-defined]
    with pytest.raises((ProtocolError, DeviceLost)):
        flipped.position()


def test_a_tmc2209_that_lost_its_power_is_told_and_stops() -> None:
    clock, machine = VirtualClock(), EmulatedTmc2209()
    stage = tmc_of(machine, clock)
    stage.run(60.0)
    machine.track.run(clock.now(), 0.0)
    with pytest.raises(DeviceLost, match=r"made -?0\.\d\d of its steps; expected 1: check its power"):
        for _ in range(60):
            clock.sleep(SECOND // 60)
            stage.position()
    machine.received.clear()
    stage.stop()
    assert machine.received[0][2:7] == bytes([0x80 | 0x22, 0, 0, 0, 0]) and not stage.busy()


def test_a_tmc2209_stops_without_an_answer() -> None:
    clock, machine = VirtualClock(), EmulatedTmc2209()
    stage = tmc_of(machine, clock)
    stage.run(60.0)
    stage._wire.port.faults.flip_out = frozenset(range(10_000))  # type: ignore[attr-defined]
    with pytest.raises((ProtocolError, DeviceLost)):
        stage.stop()
    assert not machine.track.moving(clock.now() + SECOND)


@pytest.mark.parametrize("name", ["tmc2209", "own"])
def test_a_move_that_fails_leaves_no_motor_running(name: str) -> None:
    board, opened, _ = ALL[name]
    clock = VirtualClock()
    machine = board()
    stage = opened(machine, clock)
    stage.run(20.0)
    clock.sleep(SECOND // 4)
    place, asked = stage.position, list[float]()

    def lost() -> float:
        if len(asked) == 3:
            raise DeviceLost("no answer")
        asked.append(place())
        return asked[-1]

    stage.position = lost
    with pytest.raises(DeviceLost, match="no answer"):
        stage.move(90.0, 20.0)
    stage.position = place
    clock.sleep(SECOND)
    assert asked and not machine.track.moving(clock.now())
    speeds, run = list[float](), stage.run
    stage.run = lambda speed: speeds.append(speed) or run(speed)
    stage.move(stage.position(), 20.0)
    assert speeds == [0.0], "it is there already"


def test_grbl_to_the_byte() -> None:
    clock, machine = VirtualClock(), EmulatedGrbl(axis=1)
    stage = grbl_of(machine, clock)
    assert machine.received == [b"?", b"?", b"$$"]
    stage.move(90.0, 40.0)
    assert machine.received[-1] == b"$J=G53G21Y90.000F2400.0000"
    stage.wait()
    stage.run(-40.0)
    assert machine.received[-1] == b"$J=G91G21Y-3600.000F2400.0000"
    stage.stop()
    assert machine.received[-1] == b"\x85"


def test_grbl_turns_on_beyond_a_jog() -> None:
    clock, machine = VirtualClock(), EmulatedGrbl()
    stage = grbl_of(machine, clock)
    stage.run(60.0)
    for _ in range(90):
        clock.sleep(SECOND)
        assert machine.track.moving(clock.now())
        stage.position()
    assert stage.position() == pytest.approx(60.0 * 90, rel=0.01)
    clock.sleep(200 * SECOND)
    assert not machine.track.moving(clock.now()), "it does not turn forever without its host"


def test_grbl_moves_from_a_run_without_its_jogs() -> None:
    clock, machine = VirtualClock(), EmulatedGrbl()
    stage = grbl_of(machine, clock)
    stage.run(20.0)
    clock.sleep(SECOND)
    stage.move(90.0, 20.0)
    stage.wait()
    assert stage.position() == 90.0 and not machine.queued


def test_what_grbl_would_do_otherwise_is_told() -> None:
    settings = EmulatedGrbl().settings
    with pytest.raises(WrongDevice, match=r"80 steps per deg \(\$100\)"):
        grbl_of(EmulatedGrbl(), VirtualClock(), 160.0)
    with pytest.raises(DeviceRefused, match="soft limits"):
        grbl_of(EmulatedGrbl(settings=settings | {20: 1}), VirtualClock())
    with pytest.raises(DeviceRefused, match="in alarm"):
        grbl_of(EmulatedGrbl(locked=True), VirtualClock())
    with pytest.raises(WrongDevice, match="does not answer '\\?'"):
        grbl_of(EmulatedGrbl(settings=settings | {10: 0}), VirtualClock())
    slow = grbl_of(EmulatedGrbl(wakes=SECOND), VirtualClock())  # a board that restarts as its port is opened
    with pytest.raises(BadInput, match="100 at most"):
        slow.run(120.0)
    with pytest.raises(BadInput, match="100 at most"):
        slow.move(10.0, 120.0)
    locked = EmulatedGrbl()
    stage = grbl_of(locked, VirtualClock())
    locked.locked = True
    with pytest.raises(DeviceRefused, match="error:9"):
        stage.move(10.0, 20.0)


def test_a_firmware_that_refuses_or_says_nothing() -> None:
    clock = VirtualClock()
    with pytest.raises(WrongDevice, match="does not answer 'X"):
        own_of(EmulatedFirmware(), clock, OWN._replace(ask="X\n", refused="nothing"))
    stage = own_of(EmulatedFirmware(), clock, OWN._replace(run="Q {speed}\n"))
    with pytest.raises(DeviceRefused, match="ERROR unknown"):
        stage.run(20.0)
    quiet = own_of(EmulatedFirmware(), clock, OWN._replace(accepted=""))
    quiet.run(20.0)
    clock.sleep(SECOND)
    assert quiet.position() == pytest.approx(20.0, rel=0.02)
    with pytest.raises(BadInput, match="are impossible"):
        TextStage(Wire(VirtualPort(EmulatedFirmware(), clock), "the board"), OWN, 0.0)
    stuck: Any = own_of(EmulatedFirmware(), clock)
    stuck._patience = 1.0
    stuck._wire.port.machine.track.run = lambda now, speed: None
    with pytest.raises(DeviceError, match="does not reach"):
        stuck.move(100.0, 20.0)


RIG = '[rig]\nname = "lab"\nmachine = "vial"\n[display]\ndriver = "video"\nslots = 1\norder = ["blue"]\n[motion]\n'


def test_each_is_opened_from_a_rig_file() -> None:
    lines = (
        'ask = "P"\nanswer = "pos (?P<steps>-?[0-9]+)"\nrun = "V {steps_per_s:.2f}"\nstop = "S"\naccepted = "done"\n'
    )
    for driver, machine, more in (
        ("tic", EmulatedTic(), "microsteps = 8.888888888888889\n"),
        ("tmc2209", EmulatedTmc2209(), "microsteps = 142.22222222222223\n"),
        ("grbl", EmulatedGrbl(), "microsteps = 80.0\n"),
        ("text", EmulatedFirmware(), f"microsteps = 8.888888888888889\n{lines}"),
    ):  # fmt: skip
        with PtyServer(machine) as server:
            text = f'{RIG}driver = "{driver}"\nport = "{server.url}"\n{more}'
            with pytest.raises(JobError, match=r"motion.microsteps is missing; add microsteps = … to \[motion\]"):
                parse_rig("\n".join(line for line in text.splitlines() if "microsteps" not in line.split(" = ")[0]))
            rig = parse_rig(text)
            with rig.setup.motion.open("deg") as stage:  # type: ignore[attr-defined]
                assert stage.position() == pytest.approx(0.0, abs=0.01)
                stage.run(20.0)
                stage.position()
                assert machine.track.velocity(2**62) > 0


@pytest.mark.parametrize(
    ("line", "why"),
    (
        ('run = "V {steps_per_s"', "malformed"),
        ('run = "V {speed.__class__}"', "malformed"),
        ('run = "V {speed:>999999999f}"', "malformed"),
        ('answer = "pos (.*)"', "no place"),
        ('answer = "pos ("', "malformed"),
    ),
)
def test_lines_that_cannot_be_said_are_refused(line: str, why: str) -> None:
    good = {"microsteps": "8.9", "ask": '"P"', "answer": '"(?P<steps>[0-9]+)"', "run": '"V {speed}"', "stop": '"S"'}
    key, _, value = line.partition(" = ")
    text = "".join(f"{name} = {given}\n" for name, given in (good | {key: value}).items())
    with pytest.raises(JobError, match=why):
        parse_rig(f'{RIG}driver = "text"\nport = "/dev/x"\n{text}')

"""Diode lasers that take commands: their lines to the byte, their interlock, and a light that does not go off."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest
from servers import PtyServer

from vamgpu.errors import BadInput, DeviceError, DeviceLost, DeviceRefused, WrongDevice
from vamgpu.hosts.drivers.diode_laser import DiodeLaser
from vamgpu.hosts.drivers.wire import Wire
from vamgpu.hosts.emulators.clock import VirtualClock
from vamgpu.hosts.emulators.line import LineDevice, VirtualPort
from vamgpu.hosts.rigs.config import read_rig

EPFL = Path(__file__).parents[2] / "docs" / "rigs" / "epfl.toml"


@dataclass(eq=False)
class EmulatedLaser(LineDevice):
    """A laser of a kind, with its interlock; ``stuck`` does not go off."""

    kind: str = "cobolt"
    locked: bool = True  # the interlock is closed
    stuck: bool = False
    mute: str = ""  # command that it does not answer

    def __post_init__(self) -> None:
        super().__init__(300.0)
        self.received: list[str] = []
        self.lit, self.watts = False, 0.0
        self.on_lit: Callable[[bool], None] = lambda lit: None

    def receive(self, data: bytes, now: int) -> None:
        """Take bytes."""
        for line in self.lines(data.replace(b"\r", b"\n")):
            self.received.append(line.decode("ascii"))
            said = self._act(self.received[-1])
            if self.received[-1] != self.mute:
                self._out.put("".join(f"{each}\r\n" for each in said).encode("ascii"), now)

    def _act(self, line: str) -> list[str]:
        cobolt, (word, _, value) = self.kind == "cobolt", line.partition(" ")
        match word:
            case "ilk?" if cobolt:
                return ["0" if self.locked else "1"]
            case "l?" if cobolt:
                return ["1" if self.lit else "0"]
            case "SYST:LOCK?" if not cobolt:
                return ["ON" if self.locked else "OFF", "OK"]
            case "SOUR:AM:STAT?" if not cobolt:
                return ["ON" if self.lit else "OFF", "OK"]
            case "l1" | "l0" if cobolt:
                self._light(word == "l1")
            case "SOUR:AM:STAT" if not cobolt:
                self._light(value == "ON")
            case "p" | "SOUR:POW:LEV:IMM:AMPL" if cobolt == (word == "p"):
                self.watts = float(value)
            case "cp" | "SOUR:AM:INT" if cobolt == (word == "cp"):
                pass
            case _:
                return ["Syntax error: illegal command" if cobolt else "ERR-100"]
        return ["OK"]

    def _light(self, on: bool) -> None:
        self.lit = (on and self.locked) or (self.stuck and self.lit)
        self.on_lit(self.lit)


def laser_of(machine: EmulatedLaser, kind: str | None = None, clock: VirtualClock | None = None) -> DiodeLaser:
    return DiodeLaser(Wire(VirtualPort(machine, clock or VirtualClock(), 0.05), "the laser"), kind or machine.kind, 0.2)


@pytest.mark.parametrize(
    ("kind", "told"),
    (
        ("cobolt", ["l0", "l?", "cp", "ilk?", "p 0.1000", "l1", "l0", "l?"]),
        ("obis", ["SOUR:AM:STAT OFF", "SOUR:AM:STAT?", "SOUR:AM:INT CWP", "SYST:LOCK?",
                  "SOUR:POW:LEV:IMM:AMPL 0.10000", "SOUR:AM:STAT ON", "SOUR:AM:STAT OFF", "SOUR:AM:STAT?"]),
    ),
)  # fmt: skip
def test_its_lines_to_the_byte(kind: str, told: list[str]) -> None:
    machine = EmulatedLaser(kind)
    machine.lit = True  # a host that died left it on
    with laser_of(machine) as laser:
        assert not machine.lit
        laser.on(0.5)
        assert machine.lit and machine.watts == 0.1
    assert not machine.lit and machine.received == told


@pytest.mark.parametrize("kind", ("cobolt", "obis"))
def test_an_open_interlock_gives_no_light(kind: str) -> None:
    machine = EmulatedLaser(kind, locked=False)
    laser = laser_of(machine)
    with pytest.raises(DeviceRefused, match="open interlock"):
        laser.on()
    assert not machine.lit and machine.received[-1] in ("ilk?", "SYST:LOCK?")


def test_a_light_that_does_not_go_off_is_told() -> None:
    machine = EmulatedLaser()
    laser = laser_of(machine)
    laser.on()
    laser.inspect()
    machine.lit = False
    with pytest.raises(DeviceError, match="is off, and should be on"):
        laser.inspect()
    machine.lit = machine.stuck = True
    with pytest.raises(DeviceLost, match="is not off .* by hand"):
        laser.off()
    laser._wire.port.unplug()  # type: ignore[attr-defined]
    with pytest.raises(DeviceLost):
        laser.off()
    with pytest.raises(WrongDevice, match="does not answer as a laser 'obis'"):
        laser_of(EmulatedLaser(), "obis")
    with pytest.raises(BadInput, match="expected one of cobolt, obis"):
        laser_of(EmulatedLaser(), "lamp")


def test_a_lost_answer_does_not_hide_whether_it_is_on() -> None:
    machine = EmulatedLaser(mute="l1")
    laser = laser_of(machine)
    with pytest.raises(DeviceLost, match="does not answer 'l1'"):
        laser.on()
    laser.inspect()
    machine.lit = False
    with pytest.raises(DeviceError, match="is off, and should be on"):
        laser.inspect()
    machine.lit, machine.mute = True, "l0"
    laser.off()
    assert not machine.lit, "its state answers for the command"


def test_a_rig_file_drives_it_at_its_power() -> None:
    machine = EmulatedLaser()
    with PtyServer(machine) as server:
        rig = read_rig(EPFL, ["light.driver=diode laser", f"light.port={server.url}", "light.kind=cobolt",
                              "light.watts=0.5", "light.power=0.8"])  # fmt: skip
        with rig.setup.light.open() as laser:  # type: ignore[union-attr]
            laser.on(1.0)
            assert machine.lit and machine.watts == pytest.approx(0.4)
    assert not machine.lit

"""What every driver on a line says of machines that are not its own, that babble or fail, and of other programs."""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from servers import PtyServer

from vamgpu.errors import DeviceBusy, DeviceLost, DeviceRefused, ProtocolError, WrongDevice
from vamgpu.hosts.drivers.controller import Controller
from vamgpu.hosts.drivers.lens import LensDriver
from vamgpu.hosts.drivers.scpi import PowerMeter
from vamgpu.hosts.drivers.stages import ZaberStage
from vamgpu.hosts.drivers.wire import Wire, open_wire
from vamgpu.hosts.emulators.calibration import EmulatedMeter
from vamgpu.hosts.emulators.clock import VirtualClock
from vamgpu.hosts.emulators.controller import EmulatedController
from vamgpu.hosts.emulators.lens import EmulatedLens
from vamgpu.hosts.emulators.line import Faults, Outbox, VirtualPort
from vamgpu.hosts.emulators.stage import EmulatedStage

MILLI, SECOND = 1_000_000, 1_000_000_000


class _Noise:
    """Answers with bytes of no meaning; if it ``babbles``, sends lines of its own instead, as a GPS receiver does."""

    def __init__(self, seed: int = 0, babbles: bool = False, silent: bool = False) -> None:
        self._random, self._babbles, self._silent = random.Random(seed), babbles, silent
        self._out, self._next = Outbox(), 0

    def receive(self, data: bytes, now: int) -> None:
        if not self._silent and not self._babbles:
            self._out.put(self._random.randbytes(3 * len(data)), now)

    def take(self, now: int) -> bytes:
        return self._out.take(now)

    def ready(self) -> int | None:
        return self._out.ready()

    def due(self) -> int | None:
        return self._next if self._babbles else None

    def advance(self, now: int) -> None:
        while self._babbles and self._next <= now:
            self._out.put(b"$GPGGA,104210.00,,,,,0,00,99.99,,,,,,*63\r\n", self._next)
            self._next += MILLI


DRIVERS: dict[str, Callable[[Wire], Any]] = {
    "lens": LensDriver,
    "controller": Controller,
    "stage": lambda wire: ZaberStage(wire, 1000.0),
    "meter": PowerMeter,
}
MACHINES: dict[str, Callable[[], Any]] = {
    "lens": EmulatedLens,
    "controller": EmulatedController,
    "stage": EmulatedStage,
    "meter": lambda: EmulatedMeter(lambda now: 1.0),
}
STRANGERS: dict[str, Callable[[], Any]] = {
    "noise": _Noise,
    "other noise": lambda: _Noise(1),
    "babble": lambda: _Noise(babbles=True),
    "silence": lambda: _Noise(silent=True),
}


class _Closing(VirtualPort):
    """Remembers that it was let go of."""

    closed = False

    def close(self) -> None:
        self.closed = True
        super().close()


@pytest.mark.parametrize("driver", DRIVERS)
@pytest.mark.parametrize("machine", [*MACHINES, *STRANGERS])
def test_who_is_not_meant_is_told_and_let_go_of(driver: str, machine: str) -> None:
    clock = VirtualClock()
    port = _Closing((MACHINES | STRANGERS)[machine](), clock, 0.1, 0, Faults())
    wire = Wire(port, f"the {driver}")
    if driver == machine:
        DRIVERS[driver](wire)
        return
    with pytest.raises(WrongDevice):
        DRIVERS[driver](wire)
    assert port.closed and clock.now() < 60 * SECOND


OPENERS: dict[str, Callable[[str], Any]] = {
    "lens": LensDriver.open,
    "controller": Controller.open,
    "stage": lambda url: ZaberStage.open(url, 1000.0),
    "meter": PowerMeter.open,
}


@pytest.mark.parametrize("kind", OPENERS)
def test_a_port_has_one_program(kind: str) -> None:
    with PtyServer(MACHINES[kind]()) as server:
        first = OPENERS[kind](server.url)
        with pytest.raises(DeviceBusy, match="another program"):
            OPENERS[kind](server.url)
        first.close()


def test_an_instrument_on_usb_has_one_program(tmp_path: Path) -> None:
    file = tmp_path / "clock-usbtmc0"
    file.touch()
    with open_wire(f"usbtmc:{file}", "the meter"), pytest.raises(DeviceBusy, match="another program"):
        open_wire(f"usbtmc:{file}", "the meter")
    open_wire(f"usbtmc:{file}", "the meter").close()


class _Other(EmulatedController):
    """A controller that says something else of itself."""

    def __init__(self, answer: str) -> None:
        super().__init__()
        self._answer = answer

    def _do_hello(self, now: int) -> str:
        return self._answer


@pytest.mark.parametrize(
    "answer",
    ["ok vam-controller 1 256 1000 2", "ok ramps 2 256 1000 2", "ok vam-controller one 256 1000 2", "ok", "no verb"],
)
def test_the_controllers_firmware_must_be_the_librarys(answer: str) -> None:
    with pytest.raises(WrongDevice):
        Controller(Wire(VirtualPort(_Other(answer), VirtualClock(), 0.1), "the controller"))


def _stage() -> tuple[ZaberStage, Faults, VirtualClock]:
    clock, faults = VirtualClock(), Faults()
    stage = ZaberStage(Wire(VirtualPort(EmulatedStage(rotary=True), clock, 0.1, faults=faults), "the stage"), 1000.0)
    return stage, faults, clock


def test_a_stages_damaged_answers_are_never_believed() -> None:
    length = len(b"@01 1 02 OK IDLE -- 0:00\r\n")
    for way in ("flip_out", "drop_out"):
        for byte in range(length - 2):
            stage, faults, clock = _stage()
            setattr(faults, way, frozenset({faults._count["out"] + byte}))
            with pytest.raises((ProtocolError, DeviceLost)):
                stage.position()
            clock.sleep(SECOND)
            assert stage.position() == 0.0, "the line recovers"


def test_a_stages_damaged_commands_are_not_obeyed() -> None:
    stage, faults, clock = _stage()
    faults.drop_in = frozenset({faults._count["in"] + 20})
    with pytest.raises(DeviceLost, match="does not answer"):
        stage.ask("move abs 1234567")
    clock.sleep(SECOND)
    assert stage.position() == 0.0


def test_a_stage_without_the_axis_is_told() -> None:
    machine = EmulatedStage()
    machine.settings["deviceid"] = "NA"  # type: ignore[assignment]
    with pytest.raises(WrongDevice, match="expected a number"):
        ZaberStage(Wire(VirtualPort(machine, VirtualClock(), 0.1), "the stage"), 1000.0)


def test_the_lenss_damaged_answers_are_never_believed() -> None:
    for way in ("flip_out", "drop_out"):
        for byte in range(9):
            clock, faults = VirtualClock(), Faults()
            lens = LensDriver(Wire(VirtualPort(EmulatedLens(), clock, 0.1, faults=faults), "the lens driver"))
            setattr(faults, way, frozenset({faults._count["out"] + byte}))
            with pytest.raises((ProtocolError, DeviceRefused)) as told:
                lens.temperature()
            assert "check" in str(told.value)
            assert lens.temperature() == 25.0, "the line recovers"


def test_an_instruments_late_answer_is_not_the_next_ones() -> None:
    clock = VirtualClock()
    machine = EmulatedMeter(lambda now: 1.0)
    meter = PowerMeter(Wire(VirtualPort(machine, clock, 0.02), "the meter"))
    machine._out.latency_ns = 50 * MILLI
    with pytest.raises(DeviceLost):
        meter.power_mw()
    machine._out.latency_ns = MILLI
    clock.sleep(100 * MILLI)
    meter.check()
    assert meter.power_mw() == pytest.approx(1.0)


def test_an_instruments_half_answer_is_told() -> None:
    clock, faults = VirtualClock(), Faults()
    meter = PowerMeter(Wire(VirtualPort(EmulatedMeter(lambda now: 1.0), clock, 0.1, faults=faults), "the meter"))
    faults.drop_out = frozenset({faults._count["out"] + len("1.000000000E-03")})
    with pytest.raises(ProtocolError, match="line end"):
        meter.power_mw()
    assert meter.power_mw() == pytest.approx(1.0)

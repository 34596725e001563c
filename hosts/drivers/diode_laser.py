"""Diode lasers that take commands at a serial port, Cobolt's and Coherent's OBIS, by a table of their lines."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import NamedTuple, Self

from vamgpu.errors import BadInput, DeviceError, DeviceLost, DeviceRefused, WrongDevice
from vamgpu.hosts.drivers.cleanup import ClosedOnce, closed_on_error
from vamgpu.hosts.drivers.wire import Wire, open_wire


class LaserLines(NamedTuple):
    """Commands of a kind of lasers, and the answers to queries. ``power`` takes {watts}."""

    interlock: tuple[str, str]  # query, and the answer of a closed interlock
    steady: str  # choose a steady power
    power: str
    on: str
    off: str
    dark: tuple[str, str]  # query, and the answer of a laser that is off
    refused: str  # patterns of the answers to commands
    accepted: str = "^OK"


KINDS = {
    "cobolt": LaserLines(
        ("ilk?", "0"), "cp", "p {watts:.4f}", "l1", "l0", ("l?", "0"), r"(?i)^(syntax )?error"
    ),
    "obis": LaserLines(
        ("SYST:LOCK?", "ON"), "SOUR:AM:INT CWP", "SOUR:POW:LEV:IMM:AMPL {watts:.5f}", "SOUR:AM:STAT ON",
        "SOUR:AM:STAT OFF", ("SOUR:AM:STAT?", "OFF"), r"^ERR-?\d+",
    ),
}  # fmt: skip


class DiodeLaser(ClosedOnce):
    """A laser whose power at full drive is ``watts``; it is off until `on`."""

    watts: float
    called = "the laser"

    def __init__(self, wire: Wire, kind: str, watts: float) -> None:
        self._wire, self._lit = wire, False
        with closed_on_error(wire):
            if kind not in KINDS or not watts > 0:
                raise BadInput(f"a laser {kind!r} of {watts} W; expected one of {', '.join(KINDS)}, and more than 0 W")
            self._says, self.watts = KINDS[kind], watts
            try:
                self.off()
            except DeviceError as error:
                raise WrongDevice(f"{wire.name} does not answer as a laser {kind!r}: {error}") from error
            self._tell(self._says.steady)

    @classmethod
    def open(cls, port: str, kind: str, watts: float, baud: int = 115200) -> Self:
        return cls(open_wire(port, "the laser", baud), kind, watts)

    def _tell(self, text: str, pattern: str | None = None) -> str:
        """Send a command or query, and return the answer."""
        return self._wire.exchange(f"{text}\r", pattern or self._says.accepted, self._says.refused).string

    def on(self, power: float = 1.0) -> None:
        """Turn the light on at a share of the power; DeviceRefused with an open interlock."""
        query, closed = self._says.interlock
        if (said := self._tell(query, r"\S")) != closed:
            raise DeviceRefused(f"{self._wire.name} has an open interlock (it says {said}); close it", "interlock")
        self._tell(self._says.power.format(watts=power * self.watts))
        self._lit = True  # it may be on even if it does not answer
        self._tell(self._says.on)

    def off(self) -> None:
        """Turn the light off, and check that it is; DeviceLost if it may be on."""
        with suppress(DeviceRefused, DeviceLost):
            self._tell(self._says.off)
        self._lit = False
        query, dark = self._says.dark
        if (said := self._tell(query, r"\S")) != dark:
            raise DeviceLost(f"{self._wire.name} is not off (it says {said}); switch it off by hand")

    def inspect(self) -> None:
        """Raise `DeviceError` if it is off and should be on."""
        query, dark = self._says.dark
        if self._lit and self._tell(query, r"\S") == dark:
            raise DeviceError(f"{self._wire.name} is off, and should be on; check its interlock and its temperature")

    def endings(self) -> tuple[Callable[[], object], ...]:
        return self.off, self._wire.close

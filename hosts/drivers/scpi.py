"""Photodiode meters that speak SCPI, as text in lines."""

from __future__ import annotations

import math
from typing import Self

from vamgpu.errors import BadInput, DeviceLost, DeviceRefused, ProtocolError, WrongDevice
from vamgpu.hosts.drivers.cleanup import Closing, closed_on_error
from vamgpu.hosts.drivers.wire import Wire, open_wire

MILLI = 1000.0


class PowerMeter(Closing):
    """A photodiode's meter that speaks SCPI, such as Thorlabs' PM100 and PM400."""

    def __init__(self, wire: Wire) -> None:
        self._wire = wire
        with closed_on_error(wire):
            self.identity: str = self._identify()
            self.tell("*CLS")

    @classmethod
    def open(cls, url: str, baud: int = 115200, timeout_s: float = 2.0) -> Self:
        """Open the meter at an address, such as ``usbtmc:/dev/usbtmc0``."""
        return cls(open_wire(url, "the power meter", baud, timeout_s))

    def _identify(self) -> str:
        """Maker, model, serial number and version."""
        try:
            identity = self.ask("*IDN?")
        except (DeviceLost, ProtocolError) as error:
            raise WrongDevice(f"{self._wire.name} does not identify itself: {error}") from error
        if not identity.isascii() or not identity.isprintable() or identity.count(",") not in (2, 3):
            raise WrongDevice(f"{identity!r} answers at {self._wire.name}, which is not an instrument; check the port")
        return identity

    def tell(self, text: str) -> None:
        """Send a command without an answer."""
        with self._wire.lock:
            self._wire.send(text.encode("ascii") + b"\n")

    def ask(self, text: str) -> str:
        """Send a query and return the answer."""
        with self._wire.lock:
            self._wire.drain()  # a late answer does not belong to the next query
            self._wire.send(text.encode("ascii") + b"\n")
            answer = self._wire.line()
        if not answer:
            raise DeviceLost(f"{self._wire.name} does not answer {text!r}; check its power, the port and the baud rate")
        if not answer.endswith(b"\n"):
            raise ProtocolError(f"{self._wire.name} sent {answer!r} without a line end; check the baud rate")
        return answer.decode("ascii", "replace").strip()

    def number(self, text: str) -> float:
        answer = self.ask(text)
        try:
            value = float(answer)
        except ValueError:
            raise ProtocolError(f"{self._wire.name} answered {answer!r} to {text!r}, expected a number") from None
        if not math.isfinite(value) or abs(value) >= 9e37:
            raise DeviceRefused(f"{self._wire.name} has no value ({answer}) for {text!r}; check its sensor", "range")
        return value

    def check(self) -> None:
        """Raise DeviceRefused if a command since the last check failed."""
        answer = self.ask("SYST:ERR?")
        code, _, text = answer.partition(",")
        if code.strip().lstrip("+") != "0":
            raise DeviceRefused(f"{self._wire.name} refused a command: {text.strip()}", code.strip())

    def wavelength(self, nanometers: float) -> None:
        """Set the wavelength for the correction of readings [nm]."""
        if not 100 < nanometers < 3000:
            raise BadInput(f"a wavelength of {nanometers} nm is outside the range of photodiodes; give nanometers")
        self.tell(f"SENS:CORR:WAV {nanometers:g}")
        self.check()

    def average(self, count: int) -> None:
        """Set the number of samples per reading."""
        self.tell(f"SENS:AVER:COUN {count}")
        self.check()

    def power_mw(self) -> float:
        """The present optical power [mW]."""
        return self.number("MEAS:POW?") * MILLI

    def close(self) -> None:
        self._wire.close()

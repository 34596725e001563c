"""Tunable lenses on an Optotune Lens Driver 4 or 4i."""

from __future__ import annotations

import logging
from typing import ClassVar, Protocol, Self

from vamgpu.errors import DeviceError, DeviceRefused, ProtocolError, WrongDevice
from vamgpu.hosts.drivers import optotune_protocol as ld4
from vamgpu.hosts.drivers.cleanup import Closing, closed_on_error
from vamgpu.hosts.drivers.wire import Wire, open_wire

log: logging.Logger = logging.getLogger(__name__)
WINDOW = (20.0, 45.0)  # temperatures [degC] in which the lens keeps its focal power


class Lens(Protocol):
    """A tunable lens that the host sets. same: greatest difference of its power from the one set [1/m]."""

    same: ClassVar[float]
    _set: float | None = None

    # set the focal power [1/m]; returns before the lens has settled
    def set_power(self, diopters: float) -> None: ...
    def power(self) -> float: ...  # the focal power set [1/m]
    def temperature(self) -> float: ...  # of the lens [degC]; DeviceRefused without a sensor
    def status(self) -> tuple[str, ...]: ...  # faults
    def revive(self) -> None: ...  # start again after it lost its power, at its last focal power
    def close(self) -> None: ...  # release it

    def inspect(self) -> float:
        """The power set [1/m]. Raises `DeviceError` for a fault, or another power than the one set last."""
        if said := self.status():
            raise DeviceRefused(f"the lens reports {', '.join(said)}; check its cable, and let it warm up", "status")
        power = self.power()
        if self._set is not None and abs(power - self._set) > self.same:
            raise DeviceError(f"the lens is at {power:.3f} dpt; expected {self._set:.3f}: set it again")
        return power


class LensDriver(Closing, Lens):
    """A lens driver: one handshake, then settings without answers; no schedule waits for it."""

    same: float = ld4.STEP_DIOPTERS

    def __init__(self, wire: Wire, firmware: str | None = None) -> None:
        self._wire = wire
        self._power_mode = False
        self._window = WINDOW
        self._expected = firmware
        with closed_on_error(wire):
            self._start(firmware)

    @classmethod
    def open(cls, url: str, firmware: str | None = None, baud: int = 115200, timeout_s: float = 0.25) -> Self:
        """Open the driver at an address; ``firmware`` is the type letter it must have (None: any)."""
        return cls(open_wire(url, "the lens driver", baud, timeout_s), firmware)

    def _start(self, expected: str | None) -> None:
        """Do the handshake, drop what some units send after it, and read the identity."""
        self._wire.drain()
        self._wire.send(ld4.HANDSHAKE.frame)
        answer = self._wire.receive(ld4.HANDSHAKE.reply_length)
        if answer != b"Ready\r\n":
            raise WrongDevice(
                f"{answer!r} came from {self._wire.name} instead of Ready; check that the port is the lens driver's"
            )
        for _ in range(4):
            if not self._wire.receive(64):
                break
        self.firmware: str = self.ask(ld4.FIRMWARE_TYPE).decode("ascii", "replace")
        if expected is not None and self.firmware != expected:
            raise WrongDevice(f"{self._wire.name} has firmware type {self.firmware}; expected {expected}")
        numbers = self.ask(ld4.VERSION)
        self.version: str = f"{numbers[0]}.{numbers[1]}.{int.from_bytes(numbers[2:4])}.{int.from_bytes(numbers[4:6])}"
        self.full_current_ma: float = int.from_bytes(self.ask(ld4.GET_FULL_CURRENT), "big") / 100
        log.info("lens driver: firmware %s %s, %.2f mA", self.firmware, self.version, self.full_current_ma)

    def ask(self, request: ld4.Request) -> bytes:
        """Send a request, and return the data of its answer."""
        with self._wire.lock:
            self._wire.send(request.frame)
            received = b""
            while (more := ld4.missing(request, received)) > 0:
                chunk = self._wire.receive(more)
                if not chunk:
                    break
                received += chunk
            try:
                return ld4.parse(request, received)
            except ProtocolError as error:
                self._wire.drain()
                raise ProtocolError(f"{self._wire.name}: {error}") from error

    def focal_power_mode(self, low_celsius: float = WINDOW[0], high_celsius: float = WINDOW[1]) -> ld4.PowerRange:
        """Set the temperature window, then the focal power mode; returns the guaranteed range [1/m]."""
        self._window = low_celsius, high_celsius
        self._power_range(ld4.set_window(low_celsius, high_celsius))
        found = self._power_range(ld4.FOCAL_POWER_MODE)
        self._power_mode = True
        return found

    def _power_range(self, request: ld4.Request) -> ld4.PowerRange:
        """The range in the answer to a request; DeviceRefused if its status reports that no focal power is held."""
        found = ld4.power_range(self.ask(request), self.firmware)
        blocking = found.status & 0b111
        if blocking:
            causes = ", ".join(ld4.status_texts(blocking))
            raise DeviceRefused(f"the lens driver cannot hold a focal power: {causes}", f"S{found.status}")
        return found

    def set_power(self, diopters: float) -> None:
        """Set the focal power [1/m]; returns when the bytes are sent, not when the lens has settled."""
        if not self._power_mode:
            raise DeviceError("the lens driver accepts focal powers only in focal power mode; call focal_power_mode()")
        self._wire.send(ld4.set_power(diopters, self.firmware).frame)
        self._set = diopters

    def code(self, diopters: float) -> int:
        """The code of a focal power [1/m], for a controller that sends it."""
        return ld4.power_code(diopters, self.firmware)

    def power(self) -> float:
        return ld4.power_of(ld4.signed(self.ask(ld4.GET_POWER)), self.firmware)

    def temperature(self) -> float:
        raw = ld4.signed(self.ask(ld4.GET_TEMPERATURE))
        if raw == ld4.NO_SENSOR:
            raise DeviceRefused("the lens has no temperature sensor; check that a lens is plugged in", "sensor")
        return raw / 16

    def status(self) -> tuple[str, ...]:
        answer = self.ask(ld4.GET_STATUS)
        texts = ld4.status_texts(answer[3])
        return (*texts, "lens not compatible") if answer[2] & 1 else texts

    def revive(self) -> None:
        """Start the driver again if it does not answer well, as after it lost its power, with its mode and power."""
        try:
            self.inspect()
            return
        except DeviceError:
            self._start(self._expected)
        if self._power_mode:
            self.focal_power_mode(*self._window)
        if self._set is not None:
            self.set_power(self._set)

    def close(self) -> None:
        """Release the port; the lens keeps its last setting."""
        self._wire.close()

"""Steppers on Trinamic's TMC2209 at its UART: speed by its own step generator, position by its microstep counter."""

from __future__ import annotations

from typing import Any, Self

from vamgpu.errors import BadInput, DeviceLost, DeviceRefused, ProtocolError, WrongDevice
from vamgpu.hosts.drivers.stages import PolledStage
from vamgpu.hosts.drivers.wire import Wire, open_wire
from vamgpu.hosts.schedules.clock import Clock, RealClock
from vamgpu.hosts.schedules.timing import SECOND

SYNC, HOST, WRITE = 0x05, 0xFF, 0x80
GCONF, WRITES, INPUTS, VACTUAL, COUNTER, CHOPPER = 0x00, 0x02, 0x06, 0x22, 0x6A, 0x6C
BY_UART = 0b1100_0000  # of GCONF: the UART stays on, microsteps come from CHOPPER
RESOLUTION = 0xF << 24  # of CHOPPER; 0 is 256 microsteps per full step
VERSION = 0x21
TURN = 1024  # values of its counter: four full steps
INTERNAL_HZ = 12e6  # its own clock, some percent off: the counter shows by how much
SHORTEST, LONGEST = SECOND // 2, 16 * SECOND  # times over which that is measured [ns]
FASTEST = 2**23 - 1
LEAST, MOST = 0.8, 1.25  # rate of its clock over the expected one; another is a motor that lost steps or power


def crc8(data: bytes) -> int:
    """Check sum: polynomial 0x07, the bits of each byte from the lowest on; 0x48 for ``05 00 00``."""
    value = 0
    for byte in data:
        for bit in range(8):
            value = (value << 1 ^ (0x07 if (value >> 7) ^ (byte >> bit & 1) else 0)) & 0xFF
    return value


def datagram(node: int, register: int, value: int | None = None) -> bytes:
    """A query of a register, or without None its new value."""
    head = bytes([SYNC, node, register if value is None else register | WRITE])
    body = head if value is None else head + value.to_bytes(4, "big")
    return body + bytes([crc8(body)])


class Tmc2209Stage(PolledStage):
    """One motor, with ``microsteps`` per unit, 256 in a full step; ask for its position at least each second."""

    def __init__(
        self, wire: Wire, microsteps: float, unit: str = "deg", node: int = 0, clock: Clock | None = None,
        **options: Any,
    ) -> None:  # fmt: skip
        self._wire, self._node, self._clock = wire, node, clock or RealClock()
        self._steps, self._rate, self._since, self._echoes = 0.0, 0.0, self._clock.now(), False
        self._hz, self._tune, self._wanted = INTERNAL_HZ, SHORTEST, 0.0
        self._begin: tuple[float, int] | None = None
        super().__init__(wire, wire.name, microsteps, unit, **options)

    def _start(self) -> None:
        try:
            version = self._read(INPUTS) >> 24
        except (DeviceLost, ProtocolError) as error:
            raise WrongDevice(f"{self._name} does not answer as a TMC2209: {error}") from error
        if version != VERSION:
            raise WrongDevice(f"{self._name} has version {version:#x}; expected a TMC2209 with {VERSION:#x}")
        self._write(VACTUAL, 0)
        self._write(GCONF, self._read(GCONF) | BY_UART)
        self._write(CHOPPER, self._read(CHOPPER) & ~RESOLUTION)
        self._steps = float(self._read(COUNTER))

    @classmethod
    def open(cls, port: str, microsteps: float, unit: str = "deg", node: int = 0, baud: int = 115200) -> Self:
        """Open the driver at a serial port; ``node`` is its address."""
        return cls(open_wire(port, "the TMC2209", baud), microsteps, unit, node)

    def _read(self, register: int) -> int:
        """The value of a register; a single wire also returns what was sent."""
        asked = datagram(self._node, register)
        with self._wire.lock:
            self._wire.drain()
            self._wire.send(asked)
            raw = self._wire.receive(8)
            self._echoes = raw.startswith(asked)
            if self._echoes:
                raw = raw[4:] + self._wire.receive(4)
        if len(raw) < 8:
            raise DeviceLost(f"{self._wire.name} does not answer; check its power, its plug and its address")
        if raw[:3] != bytes([SYNC, HOST, register]) or crc8(raw[:7]) != raw[7]:
            raise ProtocolError(f"{raw.hex(' ')} is not an answer of a TMC2209 to {asked.hex(' ')}; check the line")
        return int.from_bytes(raw[3:7], "big")

    def _write(self, register: int, value: int) -> None:
        """Set a register; DeviceRefused if the chip did not count the datagram."""
        before = self._read(WRITES)
        self._send(register, value)
        if self._read(WRITES) != (before + 1) % 256:
            raise DeviceRefused(f"{self._name} did not take register {register:#x}; check the line", "write")

    def _send(self, register: int, value: int) -> None:
        with self._wire.lock:
            self._wire.send(datagram(self._node, register, value))
            if self._echoes:
                self._wire.receive(8)

    def position(self) -> float:
        """The microsteps made: the counter plus its overflows by the speed, which the counter corrects."""
        asked = self._clock.now()
        value = self._read(COUNTER)
        now = (asked + self._clock.now()) // 2
        expected = self._steps + self._rate * (now - self._since) / SECOND
        self._steps = expected + (value - expected + TURN / 2) % TURN - TURN / 2
        self._since = now
        if self._begin is None:  # the first look after a change of speed
            self._begin = self._steps, now
        elif self._rate and now - self._begin[1] > self._tune:
            way = self._rate * (now - self._begin[1]) / SECOND
            if not LEAST < (ratio := (self._steps - self._begin[0]) / way) < MOST:
                raise DeviceLost(f"{self._name} made {ratio:.2f} of its steps; expected 1: check its power")
            self._hz *= ratio
            self._tune = min(2 * self._tune, LONGEST)
            self._set(self._wanted)
        return self._steps / self.microsteps

    def _set(self, rate: float) -> None:
        """Set the microsteps per second."""
        value = round(rate * 2**24 / self._hz)
        if abs(value) > FASTEST:
            raise BadInput(f"{rate:g} microsteps/s are too fast for a TMC2209; go slower")
        self._write(VACTUAL, value & 0xFFFFFF)  # 24 bits, signed
        self._wanted, self._rate, self._begin = rate, value * self._hz / 2**24, None

    def run(self, speed: float) -> None:
        """Change to a constant speed at once."""
        if speed == 0:
            self.stop()
        else:
            self.position()
            self._set(speed * self.microsteps)

    def busy(self) -> bool:
        return self._rate != 0.0

    def stop(self) -> None:
        """Stop at once, before anything is asked that might not be answered."""
        self._send(VACTUAL, 0)
        self._begin = None  # from here on the steps do not show its clock
        try:
            self.position()
        finally:
            self._set(0.0)

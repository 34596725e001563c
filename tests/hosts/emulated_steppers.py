"""Emulated boards of steppers, to the byte: Pololu's Tic, a TMC2209 at its UART, GRBL 1.1, and a firmware of a lab."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from math import floor

from vamgpu.hosts.emulators.line import LineDevice
from vamgpu.hosts.emulators.track import Track

VARIABLES = {"target_position": 0x0A, "target_velocity": 0x0E, "max_speed": 0x16}
"""Where the Tic keeps what is set, of four bytes."""
QUICK = {0x83, 0x85, 0x86, 0x89, 0x8A, 0x8C, 0x8F, 0xB0}
DEENERGIZED, TIMEOUT, SAFE_START = 1 << 0, 1 << 6, 1 << 7


@dataclass(eq=False)
class EmulatedTic(LineDevice):
    """A Tic on its serial port, in the compact protocol; ``track`` is in microsteps."""

    track: Track = field(default_factory=lambda: Track(200_000.0))
    control_mode: int = 0
    most: int = 1_000_000_000  # greatest speed in its settings
    timeout_ns: int = 1_000_000_000
    errors: int = DEENERGIZED | TIMEOUT | SAFE_START
    latency_us: float = 200.0

    def __post_init__(self) -> None:
        super().__init__(self.latency_us)
        self.received: list[bytes] = []
        self.max_speed = self.most
        self.by_position = False
        self.target = self._fed = 0

    def receive(self, data: bytes, now: int) -> None:
        """Take bytes."""
        self.advance(now)
        self._buffer += data
        while self._buffer:
            command = self._buffer[0]
            size = 1 if command in QUICK else 3 if command in (0xA1, 0xA8) else 6 if command >= 0xE0 else 2
            if len(self._buffer) < size:
                return
            raw = bytes(self._buffer[:size])
            del self._buffer[:size]
            self.received.append(raw)
            self._act(raw, now)

    def due(self) -> int | None:
        """Its time-out."""
        return None if self.errors or not self.track.moving(self._fed) else self._fed + self.timeout_ns

    def advance(self, now: int) -> None:
        """Stop the motor of a host that is silent."""
        if (due := self.due()) is not None and now >= due:
            self.errors |= TIMEOUT
            self.track.run(due, 0.0)

    def _act(self, raw: bytes, now: int) -> None:
        command = raw[0]
        value = 0
        if command >= 0xE0:
            value = sum((byte | (raw[1] >> place & 1) << 7) << 8 * place for place, byte in enumerate(raw[2:]))
            value -= (value >> 31) << 32
        match command:
            case 0x85:
                self.errors &= ~DEENERGIZED
            case 0x86:
                self.errors |= DEENERGIZED
                self.track.run(now, 0.0)
            case 0x83:
                self.errors &= ~SAFE_START
            case 0x8C:
                self.errors &= ~TIMEOUT
                self._fed = now
            case 0xE6:
                self.max_speed = value
            case 0xE0:
                self.by_position, self.target = True, value
                self.track.go(now, float(value), self.max_speed / 1e4)
            case 0xE3:
                self.by_position, self.target = False, value
                if not self.errors:
                    self.track.run(now, max(-self.max_speed, min(self.max_speed, value)) / 1e4)
            case 0xA1:
                self._out.put(self._variable(raw[1], now).to_bytes(raw[2], "little", signed=raw[2] == 4), now)
            case 0xA8:
                self._out.put(bytes([self.control_mode])[: raw[2]] if raw[1] == 1 else bytes(raw[2]), now)

    def _variable(self, offset: int, now: int) -> int:
        known = {
            0x02: self.errors, 0x09: 1 if self.by_position else 2, 0x0A: self.target, 0x16: self.max_speed,
            0x22: floor(self.track.position(now)), 0x26: round(self.track.velocity(now) * 1e4),
        }  # fmt: skip
        return known[offset]


@dataclass(eq=False)
class EmulatedTmc2209(LineDevice):
    """The chip on a single wire, which returns what it hears; ``fast`` is the true rate of its clock over 12 MHz."""

    node: int = 0
    fast: float = 1.0
    deaf: bool = False  # it takes no value
    echo: bool = True
    version: int = 0x21
    latency_us: float = 300.0

    def __post_init__(self) -> None:
        super().__init__(self.latency_us)
        self.track: Track = Track(1e9)
        self.registers: dict[int, int] = {0x00: 0x101, 0x02: 0, 0x06: self.version << 24, 0x6C: 0x1400_0053}
        self.received: list[bytes] = []

    @staticmethod
    def check(data: bytes) -> int:
        """The check sum, by a shift register of single bits."""
        bits = [byte >> bit & 1 for byte in data for bit in range(8)]
        register = [0] * 8
        for bit in bits:
            top = register[7] ^ bit
            register = [top, register[0] ^ top, register[1] ^ top, *register[2:7]]
        return sum(bit << place for place, bit in enumerate(register))

    def receive(self, data: bytes, now: int) -> None:
        """Take bytes."""
        if self.echo:
            self._out.put(data, now)
        self._buffer += data
        while len(self._buffer) >= 4:
            size = 8 if self._buffer[2] & 0x80 else 4
            if len(self._buffer) < size:
                return
            raw = bytes(self._buffer[:size])
            del self._buffer[:size]
            self.received.append(raw)
            if raw[0] == 0x05 and raw[1] == self.node and self.check(raw[:-1]) == raw[-1]:
                self._act(raw, now)

    def _act(self, raw: bytes, now: int) -> None:
        register = raw[2] & 0x7F
        if raw[2] & 0x80:
            if self.deaf:
                return
            value = int.from_bytes(raw[3:7], "big")
            self.registers[register] = value
            self.registers[0x02] = (self.registers[0x02] + 1) % 256
            if register == 0x22:
                signed = value - ((value >> 23 & 1) << 24)
                self.track.run(now, signed * 12e6 * self.fast / 2**24 * 2 ** (self.registers[0x6C] >> 24 & 15))
            return
        value = floor(self.track.position(now)) % 1024 if register == 0x6A else self.registers.get(register, 0)
        body = bytes([0x05, 0xFF, register]) + value.to_bytes(4, "big")
        self._out.put(body + bytes([self.check(body)]), now)


@dataclass(eq=False)
class EmulatedGrbl(LineDevice):
    """GRBL 1.1 with three axes, of which one turns; ``track`` is in its mm."""

    axis: int = 0
    settings: dict[int, float] = field(
        default_factory=lambda: {10: 1, 13: 0, 20: 0, 100: 80.0, 101: 80.0, 102: 80.0, 110: 6000, 111: 6000, 112: 6000}
    )
    locked: bool = False
    wakes: int = 0  # its time from the opening of the port to the first answer [ns]
    latency_us: float = 500.0

    def __post_init__(self) -> None:
        super().__init__(self.latency_us)
        self.track: Track = Track(100.0)
        self.received: list[bytes] = []
        self.queued: list[tuple[float, float]] = []  # ends and speeds of jogs

    def receive(self, data: bytes, now: int) -> None:
        """Take bytes; realtime characters act at once."""
        if now < self.wakes:
            return
        self.advance(now)
        for byte in data:
            if byte in b"?\x85":
                self.received.append(bytes([byte]))
                self._realtime(byte, now)
            else:
                for line in self.lines(bytes([byte])):
                    self.received.append(line)
                    self._out.put(self._line(line.decode("ascii"), now).encode("ascii") + b"\r\n", now)

    def _realtime(self, byte: int, now: int) -> None:
        if byte == 0x85:
            self.queued.clear()
            self.track.run(now, 0.0)
            return
        state = "Alarm" if self.locked else "Jog" if self.track.moving(now) else "Idle"
        places = [0.0] * 3
        places[self.axis] = self.track.position(now)
        told = ",".join(f"{place:.3f}" for place in places)
        name = "MPos" if self.settings[10] == 1 else "WPos"
        self._out.put(f"<{state}|{name}:{told}|FS:0,0>\r\n".encode("ascii"), now)

    def _line(self, line: str, now: int) -> str:
        if line == "$$":
            return "\r\n".join([*(f"${key}={value:.3f}" for key, value in self.settings.items()), "ok"])
        jog = re.fullmatch(r"\$J=(G91|G53)G21([XYZ])(-?[\d.]+)F([\d.]+)", line)
        if jog is None:
            return "error:3"
        if self.locked:
            return "error:9"
        speed = min(float(jog[4]), self.settings[110 + self.axis]) / 60.0
        if jog[1] == "G53" and not self.queued:
            self.track.go(now, float(jog[3]), speed)
            return "ok"
        begin = self.queued[-1][0] if self.queued else self.track.position(now)
        end = float(jog[3]) + (begin if jog[1] == "G91" else 0.0)
        self.queued.append((end, speed if end > begin else -speed))
        if len(self.queued) == 1:
            self.track.run(now, self.queued[0][1])
        return "ok"

    def due(self) -> int | None:
        """The end of a jog upwards; those of the tests downwards are cancelled."""
        if not self.queued or self.queued[0][1] < 0:
            return None
        return self.track.reaches(self.queued[0][0], self.track._pieces[-1].start)

    def advance(self, now: int) -> None:
        """Go on with the next jog, or stop."""
        while (at := self.due()) is not None and at <= now:
            self.queued.pop(0)
            if not self.queued:
                self.track.run(at, 0.0)
            else:
                self.track.run(at, self.queued[0][1])


@dataclass(eq=False)
class EmulatedFirmware(LineDevice):
    """A lab's sketch: ``V`` and a speed [steps/s], ``P`` for the steps, ``S`` to stop."""

    latency_us: float = 1000.0

    def __post_init__(self) -> None:
        super().__init__(self.latency_us)
        self.track: Track = Track(50_000.0)
        self.received: list[bytes] = []

    def receive(self, data: bytes, now: int) -> None:
        """Take bytes."""
        for line in self.lines(data):
            self.received.append(line)
            word, _, value = line.decode("ascii").partition(" ")
            if word == "P":
                self._out.put(b"pos %d\n" % floor(self.track.position(now)), now)
            elif word in ("V", "S"):
                self.track.run(now, float(value or 0.0))
                self._out.put(b"done\n", now)
            else:
                self._out.put(b"ERROR unknown\n", now)

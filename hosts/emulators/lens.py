"""An emulated Lens Driver 4 with its lens; lengths and check sums are defined separately from the driver's coding."""

from __future__ import annotations

import struct
from bisect import bisect_right
from collections import deque
from dataclasses import dataclass
from math import cos, exp, pi, sin, sqrt

from vamgpu.hosts.emulators.line import SECOND, LineDevice


@dataclass(frozen=True)
class LensModel:
    """The lens: a damped oscillator."""

    natural_hz: float = 300.0
    damping: float = 0.9
    least: float = -1.5
    greatest: float = 3.5


class LensDynamics:
    """Focal power over time after steps of its target, in closed form."""

    def __init__(self, model: LensModel) -> None:
        self.model = model
        self._steps: deque[tuple[int, float, float, float]] = deque([(0, 0.0, 0.0, 0.0)], maxlen=4096)

    def step(self, now: int, target: float) -> None:
        """Set another target power [1/m]."""
        power, rate = self.state(now)
        while len(self._steps) > 1 and self._steps[-1][0] >= now:
            self._steps.pop()
        self._steps.append((now, power, rate, target))

    def state(self, now: int) -> tuple[float, float]:
        """Power [1/m] and its rate [1/m/s] at a time, past or future."""
        index = bisect_right(self._steps, now, key=lambda step: step[0])
        start, power, rate, target = self._steps[max(index - 1, 0)]
        t = max(now - start, 0) / SECOND
        omega = 2 * pi * self.model.natural_hz
        decay = omega * self.model.damping
        ringing = omega * sqrt(max(1 - self.model.damping**2, 1e-12))
        offset = power - target
        b = (rate + decay * offset) / ringing
        fade, c, s = exp(-decay * t), cos(ringing * t), sin(ringing * t)
        moved = fade * (offset * c + b * s)
        speed = fade * ((b * ringing - decay * offset) * c - (offset * ringing + decay * b) * s)
        return target + moved, speed


LENGTHS = {
    b"H": 3, b"V": 3, b"CrMA": 8, b"MwCA": 6, b"PwTA": 10, b"PwDA": 10, b"PrDA": 10, b"TCA": 5, b"Sr": 4,
    b"Start": 5,
}  # fmt: skip
"""Start of each command → its bytes with the check sum."""
LONGEST_NAME = max(map(len, LENGTHS))
BEGINNINGS = {name[:size] for name in LENGTHS for size in range(1, len(name))}
CRC_TABLE = [0, 0xCC01, 0xD801, 0x1400, 0xF001, 0x3C00, 0x2800, 0xE401]
CRC_TABLE += [0xA001, 0x6C00, 0x7800, 0xB401, 0x5000, 0x9C01, 0x8801, 0x4400]
FULL_MA = 292.84
PATIENCE = 20_000_000  # time that the driver waits for the rest of a command [ns]


def check_sum(data: bytes) -> int:
    """The frames' check sum, four bits at a time."""
    value = 0
    for byte in data:
        value = (value >> 4) ^ CRC_TABLE[(value ^ byte) & 15]
        value = (value >> 4) ^ CRC_TABLE[(value ^ (byte >> 4)) & 15]
    return value


@dataclass(eq=False)
class EmulatedLens(LineDevice):
    """The driver's firmware and its lens."""

    model: LensModel = LensModel()
    firmware: str = "A"
    celsius: float = 25.0
    baud: int = 115200
    sensor: bool = True  # it has a thermometer and memory
    legacy: bool = False  # answers bad frames with N, as old firmware does
    stray: bool = False  # sends an extra frame after the handshake, as some units do

    def __post_init__(self) -> None:
        super().__init__(100.0, round(10 * SECOND / self.baud))
        self.holds: bool = False  # whether it is in focal power mode
        self.power_code: int = 0
        self.window: tuple[float, float] | None = None
        self.handshakes: int = 0
        self.settings: int = 0
        self._glass = LensDynamics(self.model)
        self._heard = 0

    # the line

    def receive(self, data: bytes, now: int) -> None:
        self.advance(now)
        self._buffer += data
        self._heard = now
        while self._buffer and self._one(now):
            pass

    def due(self) -> int | None:
        """Time limit of an incomplete command."""
        return self._heard + PATIENCE if self._buffer else None

    def advance(self, now: int) -> None:
        """Drop an incomplete command after its time limit."""
        if self._buffer and now >= self._heard + PATIENCE:
            self._buffer.clear()
            self._refuse(1, now)

    def _one(self, now: int) -> bool:
        """Execute the first command in the buffer if it is complete."""
        starts = [bytes(self._buffer[:size]) for size in range(min(len(self._buffer), LONGEST_NAME), 0, -1)]
        name = next((start for start in starts if start in LENGTHS), None)
        if name is None:
            if starts[0] not in BEGINNINGS:
                self._buffer.clear()
                self._refuse(3, now)
            return False
        if len(self._buffer) < LENGTHS[name]:
            return False
        frame = bytes(self._buffer[: LENGTHS[name]])
        del self._buffer[: LENGTHS[name]]
        if name == b"Start":
            self._handshake(now)
        elif check_sum(frame):
            self._refuse(1, now)
        else:
            self._act(name, frame[len(name) : -2], now)
        return True

    def _answer(self, payload: bytes, now: int) -> None:
        value = check_sum(payload)
        self._out.put(payload + bytes((value & 255, value >> 8)) + b"\r\n", now)

    def _refuse(self, reason: int, now: int) -> None:
        if self.legacy:
            self._out.put(b"N\r\n", now)
        else:
            self._answer(b"E" + bytes((reason,)), now)

    def _handshake(self, now: int) -> None:
        self.handshakes += 1
        self.holds, self.power_code = False, 0
        self._obey(now)
        self._out.put(b"Ready\r\n", now)
        if self.stray:
            self._answer(b"E\x03", now)

    # the firmware

    def _act(self, name: bytes, data: bytes, now: int) -> None:
        if name == b"PwDA":  # not answered
            self.settings += 1
            self.power_code = struct.unpack(">h", data[:2])[0]
            self._obey(now)
        elif name == b"MwCA":
            self._hold_power(now)
        elif name == b"PwTA":
            high, low = struct.unpack(">hh", data)
            self.window = (low / 16, high / 16)
            self._answer(b"PT" + self._range(), now)
        else:
            self._answer(self._report(name), now)

    def _hold_power(self, now: int) -> None:
        if not self.sensor:
            self._refuse(4, now)
            return
        self.holds, self.power_code = True, round(self._zero() * 200)
        self._obey(now)
        self._answer(b"MCA" + self._range(), now)

    def _zero(self) -> float:
        return 5.0 if self.firmware == "A" else 0.0

    def _status(self) -> int:
        """Bits: 0 no sensor, 1 no memory, 2 no window, 5 outside the product's temperatures, 7 outside the window."""
        low, high = self.window or (-273.0, 1000.0)
        flags = 0 if self.sensor else 0b11
        flags |= 0 if self.window else 1 << 2
        flags |= 0 if 10 <= self.celsius <= 50 else 1 << 5
        return flags | (0 if low <= self.celsius <= high else 1 << 7)

    def _range(self) -> bytes:
        ends = (self.model.greatest, self.model.least)
        return struct.pack(">Bhh", self._status(), *(round((power + self._zero()) * 200) for power in ends))

    def _report(self, name: bytes) -> bytes:
        temperature = round(self.celsius * 16) if self.sensor else 4095
        reports = {
            b"H": b"H" + self.firmware.encode(),
            b"V": b"V" + struct.pack(">BBHH", 1, 9, 1000, 7),
            b"CrMA": b"CMA" + struct.pack(">H", round(100 * FULL_MA)),
            b"PrDA": b"PD" + struct.pack(">h", self.power_code),
            b"TCA": b"TCA" + struct.pack(">h", temperature),
            b"Sr": b"S" + bytes((0, 0, 0, self._status())),
        }
        return reports[name]

    # the lens

    def _obey(self, now: int) -> None:
        """Set the lens's target; without current it has a power of 0."""
        power = self.power_code / 200 - self._zero() if self.holds else 0.0
        self._glass.step(now, min(max(power, self.model.least), self.model.greatest))

    def power(self, now: int) -> float:
        """The focal power [1/m] at a time [ns], also in the past or while it settles."""
        return self._glass.state(now)[0]


class LensInput(LineDevice):
    """The lens driver's other input, with bytes of its own, at which a controller sets powers."""

    def __init__(self, lens: EmulatedLens) -> None:
        super().__init__(0.0)
        self._lens, self._heard = lens, 0

    def _swap(self) -> None:
        lens = self._lens
        lens._buffer, self._buffer = self._buffer, lens._buffer
        lens._heard, self._heard = self._heard, lens._heard

    def receive(self, data: bytes, now: int) -> None:
        self._swap()
        self._lens.receive(data, now)
        self._swap()

"""An emulated motion cube by Thorlabs: APT messages of one channel, and motion that takes time."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from vamgpu.hosts.emulators.line import LineDevice
from vamgpu.hosts.emulators.track import Track

HEAD = 6
CUBE, HOST = 0x50, 0x01


@dataclass(eq=False)
class EmulatedCube(LineDevice):
    """One axis in counts; ``track`` tells where it is."""

    model: str = "KDC101"
    speed: float = 65536 * 2048 / 6e6  # units of its speed in a count a second
    stepper: bool = False  # it counts microsteps and has their status
    acceleration: float = 1e6
    latency_us: float = 500.0
    slow: int = 0  # how long its status takes to say that it moves [ns]

    def __post_init__(self) -> None:
        super().__init__(self.latency_us)
        self.track: Track = Track(self.acceleration)
        self.profile: tuple[int, int, int] = (0, 1000, round(1e5 * self.speed))
        self.enabled: bool = False
        self.homed: bool = False
        self.received: list[bytes] = []
        self._ends = self._began = 0

    def receive(self, data: bytes, now: int) -> None:
        """Take bytes."""
        self._buffer += data
        while len(self._buffer) >= HEAD:
            longer = self._buffer[4] & 0x80
            size = HEAD + (int.from_bytes(self._buffer[2:4], "little") if longer else 0)
            if len(self._buffer) < size:
                return
            raw = bytes(self._buffer[:size])
            del self._buffer[:size]
            self.received.append(raw)
            self.advance(now)
            self._act(int.from_bytes(raw[:2], "little"), raw, now)

    def advance(self, now: int) -> None:
        """Say that a move has ended."""
        if self._ends and not self.track.moving(now):
            self._say(self._ends, struct.pack("<Hlhhi", 1, round(self.track.position(now)), 0, 0, self._bits(now)), now)
            self._ends = 0

    def _say(self, message: int, data: bytes, now: int) -> None:
        self._out.put(struct.pack("<HHBB", message, len(data), HOST | 0x80, CUBE) + data, now)

    def _bits(self, now: int) -> int:
        if now < self._began + self.slow:
            return 0x400 if self.homed else 0
        speed = self.track.velocity(now) if self.track.moving(now) else 0.0
        moving = 0x10 if speed > 0 else 0x20 if speed < 0 else 0x10 if self.track.moving(now) else 0
        return moving | (0x200 if self._ends == 0x0444 else 0) | (0x400 if self.homed else 0)

    def _act(self, message: int, raw: bytes, now: int) -> None:
        here, fast = round(self.track.position(now)), self.profile[2] / self.speed
        match message:
            case 0x0005:
                told = struct.pack("<l8sH4B60sHHH", 27000001, self.model.encode(), 16, 0, 1, 2, 3, b"", 1, 1, 1)
                self._say(0x0006, told, now)
            case 0x0210:
                self.enabled = raw[3] == 1
            case 0x0413:
                self.profile = struct.unpack_from("<3l", raw, HEAD + 2)
            case 0x0414:
                self._say(0x0415, struct.pack("<H3l", 1, *self.profile), now)
            case 0x0443:
                self.track.go(now, 0.0, fast)
                self.homed, self._ends = True, 0x0444
            case 0x0453:
                self.track.go(now, struct.unpack_from("<l", raw, HEAD + 2)[0], fast)
                self._ends, self._began = 0x0464, now
            case 0x0457:
                self.track.run(now, fast if raw[3] == 1 else -fast)
            case 0x0465:
                self.track.run(now, 0.0)
            case 0x0480 if self.stepper:
                self._say(0x0481, struct.pack("<Hlli", 1, here, 0, self._bits(now)), now)
            case 0x0490 if not self.stepper:
                self._say(0x0491, struct.pack("<Hlhhi", 1, here, 0, 0, self._bits(now)), now)

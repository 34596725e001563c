"""Emulated LightCrafters behind hidapi's device: they keep their settings, and check their tables."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from vamgpu.errors import ProtocolError
from vamgpu.hosts.drivers import dlpc350_protocol as p


@dataclass(frozen=True)
class Message:
    """A command with its data; ``flags`` hold READ, REPLY and REFUSED."""

    flags: int
    sequence: int
    command: int | None
    data: bytes


def parse_command(raw: bytes) -> Message:
    """The command in reports, as the controller reads them."""
    size = int.from_bytes(raw[2:4], "little")
    if len(raw) % p.REPORT or size < 2 or size > len(raw) - 4:
        raise ProtocolError(f"{raw!r} is no command of a DLPC350")
    return Message(raw[0], raw[1], int.from_bytes(raw[4:6], "little"), bytes(raw[6 : 4 + size]))


class EmulatedLightCrafter:
    """``settings`` holds the data of the last command of each kind; ``refuse`` the commands it does not take."""

    closed: bool
    polls: int

    def __init__(self, polls: int = 2) -> None:
        self.settings: dict[int, bytes] = {p.LED_ENABLE: b"\x08"}
        self.locked = True  # to the video cable
        self.refuse: set[int] = set()
        self.on_lit: Callable[[bool], None] | None = None
        self.silent = self.unplugged = self.closed = False
        self.late = 0  # reads that time out although an answer is coming
        self.polls, self._left, self._status = polls, 0, 0
        self._in, self._out = bytearray(), deque[bytes]()

    @property
    def lit(self) -> bool:
        """Whether light comes out: patterns run and LEDs are enabled."""
        return self.settings.get(p.DISPLAY) == b"\2" and self.settings[p.LED_ENABLE] != b"\0"

    def write(self, report: bytes) -> int:
        """Take a report with its number in front."""
        if self.unplugged:
            return -1
        self._in += report[1:]
        if len(self._in) >= 4 + int.from_bytes(self._in[2:4], "little"):
            message = parse_command(bytes(self._in))
            self._in.clear()
            self._answer(message)
        return len(report)

    def _answer(self, message: Message) -> None:
        command, flags, data = message.command or 0, message.flags, b""
        if command in self.refuse:
            flags |= p.REFUSED
        elif flags & p.READ:
            data = self._value(command)
        else:
            self._set(command, message.data)
            if command == p.VALIDATE:
                self._left, self._status = self.polls, self._judge()
        head = bytes([flags, message.sequence, len(data), 0])
        if not self.silent:
            self._out.append((head + data).ljust(p.REPORT, b"\0"))

    def _value(self, command: int) -> bytes:
        if command == p.MAIN_STATUS:
            return bytes([p.RUNNING if self.locked and self.settings.get(p.DISPLAY) == b"\2" else 0])
        return bytes([self._check()]) if command == p.VALIDATE else self.settings.get(command, b"")

    def _set(self, command: int, data: bytes) -> None:
        self.settings[command] = data
        if self.on_lit is not None:
            self.on_lit(self.lit)

    def _check(self) -> int:
        self._left -= 1
        return p.BUSY if self._left >= 0 else self._status

    def _judge(self) -> int:
        """The status of the table and times."""
        times, table = self.settings.get(p.TIMES, bytes(8)), self.settings.get(p.MAILBOX_DATA, b"")
        exposure, period = int.from_bytes(times[:4], "little"), int.from_bytes(times[4:8], "little")
        bits = {table[start + 1] & 15 for start in range(0, len(table), 3)}
        status = int(not bits or any(exposure < p.SHORTEST_US.get(each, 1 << 31) for each in bits))
        if exposure != period and exposure > period - p.DARK_US:
            status |= 0b10000
        return status

    def read(self, size: int, timeout_ms: int = 0) -> list[int]:
        """Give a report, or nothing."""
        if self.unplugged:
            raise OSError("read error")
        self.late -= (late := self.late > 0)
        return list(self._out.popleft()[:size]) if self._out and not late else []

    def close(self) -> None:
        """Let go."""
        self.closed = True


class EmulatedDlpc900(EmulatedLightCrafter):
    """A LightCrafter 6500: modes that take time, a cable that may have no signal, and a table of patterns."""

    def __init__(self, polls: int = 2, signal: bool = True) -> None:
        super().__init__(polls)
        self.signal = signal
        self.patterns: list[bytes] = []
        self.error = 0
        self.sent: list[tuple[int, bytes]] = []

    def _set(self, command: int, data: bytes) -> None:
        self.sent.append((command, data))
        if command == 0x1A1B:
            self._left = self.polls
            self.error = 0 if data != b"\2" or self._locked() else 5
        elif command == 0x1A34:
            self.patterns = [*self.patterns[: int.from_bytes(data[:2], "little")], data]
            self.error = self.error or (0 if self.settings.get(0x1A1B) == b"\2" and len(data) == 12 else 6)
        elif command == 0x1A31:
            self.error = self.error or (0 if int.from_bytes(data[:2], "little") == len(self.patterns) else 6)
        super()._set(command, data)

    def _locked(self) -> bool:
        return self.signal and self.settings.get(0x1A01) == b"\1" and self.settings.get(0x1A00) == b"\x08"

    def _value(self, command: int) -> bytes:
        self._left -= 1
        if command == 0x1A0C:
            runs = self.settings.get(0x1A24) == b"\2" and not self.error
            return bytes([runs << 1 | (self._locked() and self._left < 0) << 3])
        if command == 0x1A1B:
            return self.settings[command] if self._left < 0 else b"\0"
        return bytes([self.error]) if command == 0x0100 else self.settings.get(command, b"")

"""An emulated LightCrafter 4500 behind hidapi's device: it keeps its settings, and checks its table."""

from __future__ import annotations

from collections import deque
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
        self.silent = self.unplugged = self.closed = False
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
            data = bytes([self._check()]) if command == p.VALIDATE else self.settings.get(command, b"")
            if command == p.MAIN_STATUS:
                data = bytes([p.RUNNING if self.locked and self.settings.get(p.DISPLAY) == b"\2" else 0])
        else:
            self.settings[command] = message.data
            if command == p.VALIDATE:
                self._left, self._status = self.polls, self._judge()
        head = bytes([flags, message.sequence, len(data), 0])
        if not self.silent:
            self._out.append((head + data).ljust(p.REPORT, b"\0"))

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
        return list(self._out.popleft()[:size]) if self._out else []

    def close(self) -> None:
        """Let go."""
        self.closed = True

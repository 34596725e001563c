"""The controller's open line protocol, as in `hosts/firmware/controller/PROTOCOL.md`: lines, rows and status."""

from __future__ import annotations

from binascii import crc_hqx
from dataclasses import dataclass

from vamgpu.errors import BadInput, ProtocolError

NAME = "vam-controller"
VERSION = 3
LONGEST_LINE = 160
NUMBERS = 65536
FASTEST = 200_000  # the greatest speed of the web [microsteps/s]
LONGEST_RATIO = 1_000_000  # the greatest number of counts, marks or microsteps in a ratio
STEEPEST = 100_000_000  # the greatest acceleration [microsteps/s2]
LONGEST_LEASE_MS = 1000


@dataclass(frozen=True)
class Reply:
    """One line of the controller: ``kind`` is ``ok``, ``no``, ``!`` or ``?``; events and complaints have no number."""

    kind: str
    number: int | None
    words: tuple[str, ...]


@dataclass(frozen=True)
class ControllerRow:
    """One slot: when it acts [us or microsteps], the lens's code, and the light's delay and duration [us]."""

    index: int
    at: int
    lens: int | None
    delay_us: int
    on_us: int
    channels: int = 1

    def words(self) -> tuple[str, ...]:
        lens = "-" if self.lens is None else str(self.lens)
        return (str(self.index), str(self.at), lens, str(self.delay_us), str(self.on_us), str(self.channels))


@dataclass(frozen=True)
class Status:
    """State of the controller, from ``stat``."""

    state: str  # idle, armed, running, done or fault
    row: int  # the next row
    shown: int  # rows that were shown
    late: int  # rows that stayed dark because they were late
    free: int  # rows that still fit
    position: int  # position of the web [microsteps]
    speed: int  # speed [thousandths of microsteps/s]
    zero: int  # number under which position 0 was set; 0 since power came
    play: int  # number of the last ``go``; 0 since power came
    lease_ms: int
    light: int
    armed: bool
    interlock_closed: bool
    fault: str
    measured: int | None = None  # position of the encoder [microsteps]; None without one
    marks: int | None = None  # index marks passed; None without one
    homing: bool = False  # it searches for the mark
    astray: bool = False  # the mark was off position

    @property
    def at(self) -> int:
        """Position of the motion [microsteps]: measured, or else stepped."""
        return self.position if self.measured is None else self.measured


def line_check(data: bytes) -> int:
    """CRC-16/CCITT-FALSE: polynomial 0x1021, start 0xFFFF; 0x29B1 for ``123456789``."""
    return crc_hqx(data, 0xFFFF)


def encode(*words: object) -> bytes:
    body = " ".join(str(word) for word in words)
    line = f"{body}*{line_check(body.encode('ascii')):04X}\n".encode("ascii")
    if len(line) > LONGEST_LINE or "\n" in body or "*" in body:
        raise BadInput(f"{body!r} cannot be sent to the controller: too long, or holds * or a line end")
    return line


def check(line: bytes) -> tuple[str, ...]:
    """The words of a line with a correct check sum; ProtocolError otherwise."""
    body, star, given = line.rstrip(b"\r\n").rpartition(b"*")
    if not star or given != f"{line_check(body):04X}".encode("ascii"):
        raise ProtocolError(f"{line!r} fails its check sum; check the cable and that no other program uses the port")
    return tuple(body.decode("ascii", "replace").split(" "))


def parse(line: bytes) -> Reply:
    words = check(line)
    if words[0] in ("!", "?"):
        return Reply(words[0], None, words[1:])
    if len(words) >= 2 and words[0].isdigit() and words[1] in ("ok", "no"):
        return Reply(words[1], int(words[0]), words[2:])
    raise ProtocolError(f"{line!r} is not a line of a controller; check which device is on the port")


def parse_status(words: tuple[str, ...]) -> Status:
    try:
        state, *numbers, fault = words
        row, shown, late, free, *web, lease, light, armed, closed, senses, measured, marks = map(int, numbers)
        position, speed, zero, play = web
    except ValueError:
        raise ProtocolError(f"the controller's status {words} lacks the 17 values of version {VERSION}") from None
    seen = (measured if senses & 1 else None, marks if senses & 2 else None, bool(senses & 4), bool(senses & 8))
    stands = (position, speed, zero, play, lease, light)
    return Status(state, row, shown, late, free, *stands, bool(armed), bool(closed), fault, *seen)

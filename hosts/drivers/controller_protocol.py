"""The open line protocol of the controller that drives web, trigger, lens and light.

Lines of ASCII end in a line feed. Each carries, after ``*``, the CRC-16/CCITT-FALSE of what stands before it in four
capital hexadecimal digits. The host sends ``<number> <verb> <arguments>``; the controller answers the same number with
``ok`` and values, or ``no <reason>``. A line sent twice running is answered twice but acted on once, so a host that
heard nothing may repeat itself; ``hello`` and ``stat`` are answered afresh. Lines that begin with ``!`` are events;
``?`` answers what could not be read. Numbers of lines are 0..65535, other numbers have at most 18 digits.

========= =========================================== =================================================================
verb      arguments                                   effect; answer
========= =========================================== =================================================================
hello     \\-                                           light off, rows dropped, disarmed, no fault, the first ``ramp``
                                                      and ``mode`` again; ``vam-controller`` version, rows it can hold,
                                                      longest lease [ms], channels of light
lease     milliseconds                                the light may stay on for so long from now
arm       \\-                                           allow light; refused without a lease or with an open interlock
disarm    \\-                                           light off and not allowed
power     channel, 0..65535                           the drive of a channel, of full
light     channels                                    steady light, while armed; 0 darkens, a row's light too
mode      ``time`` or ``steps``                       what the rows count: microseconds since ``go``, or microsteps
row       index, at, lens, delay us, on us, channels  queue one slot; rows still free, and the index of the next row
end       count                                       how many rows the print has; may be told again while they run
go        1..65535                                    begin to play the rows, and to count those shown; ``stat`` tells
                                                      the number
move      thousandths of microsteps per second        run the web at a speed, ramping up to it
ramp      microsteps per second squared               how fast the speed changes
zero      1..65535                                    call this position 0; ``stat`` tells the number
stop      \\-                                           light off, then rows dropped, then the web ramped to rest
encoder   counts, microsteps, limit                   an encoder gives so many counts in so many microsteps (below 0:
                                                      it counts down), and is right here; limit: the greatest error
                                                      [microsteps]; 0 counts: there is none
index     marks, microsteps, limit                    the same for a mark that comes round
home      1..65535, thousandths of microsteps a s     run up to the next index mark, call it 0 under the number, and
                                                      come to rest; ``! home <number>``
stat      \\-                                           see ``Status``
========= =========================================== =================================================================

The web goes 200 000 microsteps per second at most, and changes its speed by 1 to 100 000 000 microsteps per second
squared; what is outside is refused. It is stepped a few microsteps at a time, with lease and interlock looked at after
each. Steps that it cannot keep up with are forgotten beyond 1000: ``position`` counts the steps it went.

The motion is compared with the encoder at each look at the lease, and with the marks as they are passed upwards: each
is to come where the first one and the ratio put it. Where they differ by more than the limit, the light is closed with
the fault ``stall`` or ``index``, and ``arm`` is refused until ``zero``, ``home``, ``encoder`` or ``index`` say where
the motion is. ``hello`` forgets encoder and marks, so that a host tells what is there.

A row acts when ``at`` is reached: a lens driver's focal power code is sent (``-`` for none), and ``delay`` microseconds
later the projector is triggered and the light of the channels (a sum of powers of two) is on for ``on`` microseconds.
A row that comes after its time stays dark and is counted as late. Triggers are 50 microseconds apart at least.

The play ends, with ``! done <shown>``, when as many rows as ``end`` told have acted and the light of the last is over.
Told again, a smaller count ends the play with the row on its way, which is not cut short; rows behind it stay queued.

The controller closes the light by itself when the lease runs out, when the interlock opens, and at ``hello``,
``disarm`` and ``stop``; it then disarms and says ``! light off <reason>``.

What an earlier host did outlives it, and ``hello``: what was shown and the number of the play until ``go``, the web's
position and the number of its zero until ``zero``. All begin at 0 when the board is switched on or reset. A host that
finds its own two numbers knows that nothing was forgotten, and that nobody else let it play rows. Boards that
reset when a host opens their port (by its DTR line, as many with a separate USB chip do) forget at that moment: disable
that as the board's maker describes, or take a board without it.
"""

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
STEEPEST = 100_000_000  # the greatest change of its speed [microsteps/s2]
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
        """The arguments of its line."""
        lens = "-" if self.lens is None else str(self.lens)
        return (str(self.index), str(self.at), lens, str(self.delay_us), str(self.on_us), str(self.channels))


@dataclass(frozen=True)
class Status:
    """State of the controller, as ``stat`` tells it."""

    state: str  # idle, armed, running, done or fault
    row: int  # the next to act
    shown: int  # rows that acted
    late: int  # rows that stayed dark as they came late
    free: int  # rows that still fit
    position: int  # of the web [microsteps]
    speed: int  # [thousandths of microsteps/s]
    zero: int  # number under which position 0 was set; 0 since power came
    play: int  # number of the last ``go``; 0 since power came
    lease_ms: int
    light: int
    armed: bool
    interlock_closed: bool
    fault: str
    measured: int | None = None  # by the encoder [microsteps]; None without one
    marks: int | None = None  # index marks passed; None without one
    homing: bool = False  # it looks for the mark
    astray: bool = False  # the mark was not where it should be

    @property
    def at(self) -> int:
        """Where the motion is [microsteps]: as measured, else as stepped."""
        return self.position if self.measured is None else self.measured


def line_check(data: bytes) -> int:
    """CRC-16/CCITT-FALSE: polynomial 0x1021, start 0xFFFF; 0x29B1 for ``123456789``."""
    return crc_hqx(data, 0xFFFF)


def encode(*words: object) -> bytes:
    """The bytes of a line."""
    body = " ".join(str(word) for word in words)
    line = f"{body}*{line_check(body.encode('ascii')):04X}\n".encode("ascii")
    if len(line) > LONGEST_LINE or "\n" in body or "*" in body:
        raise BadInput(f"{body!r} cannot be sent to the controller: too long, or holds * or a line end")
    return line


def check(line: bytes) -> tuple[str, ...]:
    """The words of a line whose check sum is right; ProtocolError otherwise."""
    body, star, given = line.rstrip(b"\r\n").rpartition(b"*")
    if not star or given != f"{line_check(body):04X}".encode("ascii"):
        raise ProtocolError(f"{line!r} fails its check sum; check the cable and that no other program uses the port")
    return tuple(body.decode("ascii", "replace").split(" "))


def parse(line: bytes) -> Reply:
    """Read a line of the controller."""
    words = check(line)
    if words[0] in ("!", "?"):
        return Reply(words[0], None, words[1:])
    if len(words) >= 2 and words[0].isdigit() and words[1] in ("ok", "no"):
        return Reply(words[1], int(words[0]), words[2:])
    raise ProtocolError(f"{line!r} is no line of a controller; check which device is on the port")


def parse_status(words: tuple[str, ...]) -> Status:
    """The status in the answer to ``stat``."""
    try:
        state, *numbers, fault = words
        row, shown, late, free, *web, lease, light, armed, closed, senses, measured, marks = map(int, numbers)
        position, speed, zero, play = web
    except ValueError:
        raise ProtocolError(f"the controller's status {words} has not the 17 values of version {VERSION}") from None
    seen = (measured if senses & 1 else None, marks if senses & 2 else None, bool(senses & 4), bool(senses & 8))
    stands = (position, speed, zero, play, lease, light)
    return Status(state, row, shown, late, free, *stands, bool(armed), bool(closed), fault, *seen)

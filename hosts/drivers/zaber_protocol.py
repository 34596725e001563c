"""Zaber's ASCII protocol: commands with message numbers and check sums, replies, and unsolicited alerts."""

from __future__ import annotations

from dataclasses import dataclass

from vamgpu.errors import BadInput, DeviceRefused, ProtocolError

SPEED_UNITS = 1.6384  # units of the device's speed in one microstep per second


def lrc(data: bytes) -> int:
    """The byte that makes the sum of all bytes a multiple of 256."""
    return -sum(data) & 0xFF


@dataclass(frozen=True)
class Message:
    """A message of a device: ``kind`` is ``@`` for a reply, ``!`` for an alert, ``#`` for information."""

    kind: str
    device: int
    axis: int
    number: int | None
    accepted: bool
    busy: bool
    warning: str
    data: str


def command(device: int, axis: int, number: int, text: str) -> bytes:
    """The bytes of a command, with its message number (0..95) and check sum."""
    if not 0 <= number <= 95:
        raise BadInput(f"message number {number} is outside 0..95")
    body = f"{device:02d} {axis} {number:02d} {text}".encode("ascii")
    return b"/" + body + f":{lrc(body):02X}\n".encode("ascii")


def parse(line: bytes) -> Message:
    """The message of one line without its ending; ProtocolError if it is not one."""
    text = line.decode("ascii", "replace").strip("\r\n")
    if len(text) < 5 or text[0] not in "@!#":
        raise ProtocolError(f"{line!r} is not a message of a Zaber device; check the port and the baud rate")
    kind, body = text[0], text[1:]
    if len(body) > 3 and body[-3] == ":":
        try:
            given = int(body[-2:], 16)
        except ValueError:
            given = -1
        body = body[:-3]
        if given != lrc(body.encode("ascii", "replace")):
            raise ProtocolError(f"the check sum of {line!r} is wrong; check the cable")
    return _fields(kind, body.split(" "), line)


def _fields(kind: str, words: list[str], line: bytes) -> Message:
    """The message of its words."""
    try:
        device, axis = int(words[0]), int(words[1])
        rest = words[2:]
        number = None
        if rest and len(rest[0]) == 2 and rest[0].isdigit():
            number, rest = int(rest[0]), rest[1:]
        if kind == "#":
            return Message(kind, device, axis, number, True, False, "--", " ".join(rest))
        accepted = True
        if kind == "@":
            if rest[0] not in ("OK", "RJ"):
                raise ValueError(rest[0])
            accepted, rest = rest[0] == "OK", rest[1:]
        if rest[0] not in ("BUSY", "IDLE"):
            raise ValueError(rest[0])
        return Message(kind, device, axis, number, accepted, rest[0] == "BUSY", rest[1], " ".join(rest[2:]))
    except (ValueError, IndexError):
        raise ProtocolError(f"{line!r} is not a message of a Zaber device; check the port and the baud rate") from None


def accept(message: Message, text: str) -> str:
    """The data of a reply to ``text``; DeviceRefused if the device rejected it or is in fault."""
    if not message.accepted:
        raise DeviceRefused(f"stage {message.device} rejected {text!r}: {message.data}", message.data)
    if message.warning.startswith("F"):
        raise DeviceRefused(f"stage {message.device} is in fault {message.warning} after {text!r}", message.warning)
    return message.data

"""Zaber's ASCII protocol: commands with message numbers and check sums, and replies to them."""

from __future__ import annotations

import re
from typing import NamedTuple

from vamgpu.errors import BadInput, DeviceRefused, ProtocolError

SPEED_UNITS = 1.6384  # units of the device's speed in one microstep per second
REPLY = re.compile(rb"@((\d\d) \d (\d\d) (OK|RJ) (BUSY|IDLE) (\S\S) (.*)):([0-9A-F]{2})\r?\n?")


def lrc(data: bytes) -> int:
    """The byte that makes the sum of all bytes a multiple of 256."""
    return -sum(data) & 0xFF


class Message(NamedTuple):
    """A reply of a device."""

    device: int
    number: int | None  # of the command
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
    """The reply in a line; ProtocolError for another line, or a wrong check sum."""
    if (found := REPLY.fullmatch(line)) is None:
        raise ProtocolError(f"{line!r} is not a reply of a Zaber device; check the port and the baud rate")
    body, device, number, flag, state, warning, data, given = found.groups()
    if int(given, 16) != lrc(body):
        raise ProtocolError(f"the check sum of {line!r} is wrong; check the cable")
    said = (warning.decode("ascii", "replace"), data.decode("ascii", "replace"))
    return Message(int(device), int(number), flag == b"OK", state == b"BUSY", *said)


def accept(message: Message, text: str) -> str:
    """The data of a reply to ``text``; DeviceRefused if the device rejected it or is in fault."""
    if not message.accepted:
        raise DeviceRefused(f"stage {message.device} rejected {text!r}: {message.data}", message.data)
    if message.warning.startswith("F"):
        raise DeviceRefused(f"stage {message.device} is in fault {message.warning} after {text!r}", message.warning)
    return message.data

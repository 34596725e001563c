"""Optotune lens drivers LD4 and 4i: requests as bytes, replies by their length, as these may hold CR and LF.

A command is payload and CRC-16/ARC, low byte first; a reply ends in CR LF. What wears out its memory is omitted.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from vamgpu.errors import BadInput, DeviceRefused, ProtocolError

ENDING = b"\r\n"
FULL_CODE = 4095
STEP_DIOPTERS = 1 / 200
NO_SENSOR = 4095
REFUSALS = {
    1: "the check sum of the command was wrong: check the cable and the ground",
    2: "this type of firmware does not have the command",
    3: "the command is not known: check that the device is a Lens Driver 4",
    4: "the lens is not compatible: check which lens is plugged in",
}
STATUS = (
    "lens or sensor missing",
    "lens memory missing or faulty",
    "no temperature limits set",
    "focal power not reachable",
    "focal power inverted",
    "outside the temperatures of the product",
    "outside the guaranteed focal power",
    "outside the temperature window set",
)


def crc16_arc(data: bytes) -> int:
    """CRC-16/ARC: polynomial 0x8005 reflected, start 0; 0xBB3D for ``123456789``, 0 for a frame with its check sum."""
    value = 0
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = (value >> 1) ^ 0xA001 if value & 1 else value >> 1
    return value


@dataclass(frozen=True)
class Request:
    """One command: the bytes to send, and the start and length of its reply (0: none without an error)."""

    payload: bytes
    prefix: bytes = b""
    reply_length: int = 0
    checked: bool = True

    @property
    def frame(self) -> bytes:
        return self.payload + struct.pack("<H", crc16_arc(self.payload)) if self.checked else self.payload


HANDSHAKE = Request(b"Start", b"Ready", 7, checked=False)
FIRMWARE_TYPE = Request(b"H", b"H", 6)
VERSION = Request(b"V", b"V", 11)
GET_FULL_CURRENT = Request(b"CrMA\0\0", b"CMA", 9)
FOCAL_POWER_MODE = Request(b"MwCA", b"MCA", 12)
GET_POWER = Request(b"PrDA" + bytes(4), b"PD", 8)
GET_TEMPERATURE = Request(b"TCA", b"TCA", 9)
GET_STATUS = Request(b"Sr", b"S", 9)


def power_code(diopters: float, firmware: str) -> int:
    """The code of a focal power [1/m]: steps of 0.005, from -5 on in firmware A, from 0 in all others."""
    code = round((diopters + (5.0 if firmware == "A" else 0.0)) / STEP_DIOPTERS)
    low, high = (0, FULL_CODE) if firmware == "A" else (-32768, 32767)
    if not low <= code <= high:
        raise BadInput(f"a focal power of {diopters} dpt has code {code}, outside {low}..{high} of firmware {firmware}")
    return code


def power_of(code: int, firmware: str) -> float:
    """The focal power [1/m] of a code."""
    return code * STEP_DIOPTERS - (5.0 if firmware == "A" else 0.0)


def set_power(diopters: float, firmware: str) -> Request:
    """Set the focal power [1/m]; it takes effect only in focal power mode, and is not answered."""
    return Request(b"PwDA" + struct.pack(">hh", power_code(diopters, firmware), 0))


def set_window(low_celsius: float, high_celsius: float) -> Request:
    """Set the temperature window of the lens; a narrow window guarantees a wide range of focal power."""
    if not low_celsius < high_celsius:
        raise BadInput(f"a temperature window from {low_celsius} to {high_celsius} degC is empty")
    return Request(b"PwTA" + struct.pack(">hh", round(high_celsius * 16), round(low_celsius * 16)), b"PT", 11)


def missing(request: Request, received: bytes) -> int:
    """Missing bytes of a reply or rejection."""
    if received[:1] == b"E" and not request.prefix.startswith(b"E"):
        return 6 - len(received)
    if received[:1] == b"N" and not request.prefix.startswith(b"N"):
        return 3 - len(received)
    return (request.reply_length or 6) - len(received) if received else 1


def parse(request: Request, received: bytes) -> bytes:
    """Return the data of a whole reply after its prefix; DeviceRefused if the device rejected the request."""
    if not received:
        raise ProtocolError(f"the lens driver did not answer {request.payload!r}; check its power and the port")
    if received == b"N" + ENDING:
        raise DeviceRefused(f"the lens driver (old firmware) refused {request.payload!r}", "N")
    if received[:1] == b"E" and not request.prefix.startswith(b"E"):
        body = _unwrap(request, received, 6)
        raise DeviceRefused(
            f"the lens driver refused {request.payload!r}: {REFUSALS.get(body[1], f'reason {body[1]}')}", f"E{body[1]}"
        )
    body = received[:-2] if not request.checked else _unwrap(request, received, request.reply_length)
    if not body.startswith(request.prefix) or not received.endswith(ENDING):
        found = received.hex(" ")
        raise ProtocolError(f"the lens driver answered {found} to {request.payload!r}; is it a Lens Driver 4?")
    return body[len(request.prefix) :]


def _unwrap(request: Request, received: bytes, length: int) -> bytes:
    """The payload of a checked reply."""
    if len(received) != length:
        raise ProtocolError(
            f"the lens driver sent {len(received)} of the {length} bytes of its answer to {request.payload!r} "
            f"({received.hex(' ')}); check the cable"
        )
    if received[-2:] != ENDING or crc16_arc(received[:-2]):
        raise ProtocolError(
            f"the answer {received.hex(' ')} of the lens driver to {request.payload!r} fails its check sum; "
            "check the cable and that no other program uses the port"
        )
    return received[:-4]


def status_texts(flags: int) -> tuple[str, ...]:
    """Texts of the bits of the first status byte."""
    return tuple(text for bit, text in enumerate(STATUS) if flags >> bit & 1)


@dataclass(frozen=True)
class PowerRange:
    """Status bits of a lens driver, and the least and greatest guaranteed focal power [1/m]."""

    status: int
    least: float
    greatest: float


def power_range(body: bytes, firmware: str) -> PowerRange:
    """The range in an answer to the focal power mode, the temperature window or the drift gain."""
    status, greatest, least = struct.unpack(">Bhh", body)
    return PowerRange(status, power_of(least, firmware), power_of(greatest, firmware))


def signed(body: bytes) -> int:
    """The signed number in a body of two bytes."""
    return struct.unpack(">h", body)[0]

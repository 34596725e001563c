"""Optotune lens drivers LD4 and 4i: requests as bytes, replies by their length.

Numbers are big-endian, the check sum (CRC-16/ARC over what precedes it) comes low byte first. A command is payload and
check sum; a reply is payload, check sum and CR LF. A payload may hold the bytes of CR and LF, so replies are read by
length and never by line. Good settings of current and focal power are not answered at all; only bad ones are.

Three of the device's commands are left out on purpose: ``RESET`` (the device then waits for new firmware), writing of
bytes into the lens's memory, and its dump. Those that wear the driver's memory say so.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum

from vamgpu.errors import BadInput, DeviceRefused, ProtocolError
from vamgpu.hosts.protocols.checks import crc16_arc

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


class Mode(IntEnum):
    """How the driver makes its current."""

    CURRENT = 1
    SINE = 2
    TRIANGLE = 3
    SQUARE = 4
    FOCAL_POWER = 5
    ANALOG = 6
    POSITION = 7


@dataclass(frozen=True)
class Request:
    """One command: the bytes to send, and the start and length of its reply (0: none when all is well)."""

    payload: bytes
    prefix: bytes = b""
    reply_length: int = 0
    checked: bool = True
    writes_memory: bool = False

    @property
    def frame(self) -> bytes:
        """Bytes on the wire."""
        return self.payload + struct.pack("<H", crc16_arc(self.payload)) if self.checked else self.payload


HANDSHAKE = Request(b"Start", b"Ready", 7, checked=False)
FIRMWARE_TYPE = Request(b"H", b"H", 6)
FIRMWARE_BRANCH = Request(b"F", b"F", 6)
PART_NUMBER = Request(b"J", b"J", 8)
VERSION = Request(b"V", b"V", 11)
LENS_SERIAL = Request(b"X", b"X", 13)
DEVICE_ID = Request(b"IR" + bytes(8), b"IR", 14)
GET_CURRENT = Request(b"Ar\0\0", b"A", 7)
GET_FULL_CURRENT = Request(b"CrMA\0\0", b"CMA", 9)
GET_UPPER_LIMIT = Request(b"CrUA\0\0", b"CUA", 9)
GET_LOWER_LIMIT = Request(b"CrLA\0\0", b"CLA", 9)
GET_MODE = Request(b"MMA", b"MMA", 8)
GET_POWER = Request(b"PrDA" + bytes(4), b"PD", 8)
GET_TEMPERATURE = Request(b"TCA", b"TCA", 9)
GET_TEMPERATURE_OLD = Request(b"TA", b"TA", 9)
GET_STATUS = Request(b"Sr", b"S", 9)
_MODES = {
    Mode.CURRENT: Request(b"MwDA", b"MDA", 7),
    Mode.SINE: Request(b"MwSA", b"MSA", 7),
    Mode.TRIANGLE: Request(b"MwTA", b"MTA", 7),
    Mode.SQUARE: Request(b"MwQA", b"MQA", 7),
    Mode.FOCAL_POWER: Request(b"MwCA", b"MCA", 12),
    Mode.ANALOG: Request(b"MwAA", b"MAA", 7),
}


def set_mode(mode: Mode) -> Request:
    """Ask for a mode; position control is set by the maker alone."""
    if mode not in _MODES:
        raise BadInput(f"the driver cannot be put into mode {mode!r}; take one of {[m.name for m in _MODES]}")
    return _MODES[mode]


def set_current(code: int) -> Request:
    """Set the current: ``code`` is current over full current times 4095, of either sign."""
    if not -FULL_CODE <= code <= FULL_CODE:
        raise BadInput(f"current code {code} is outside -{FULL_CODE}..{FULL_CODE}; ask for less current")
    return Request(b"Aw" + struct.pack(">h", code))


def current_code(current_ma: float, full_ma: float) -> int:
    """The code of a current [mA] of a driver whose full current is ``full_ma``."""
    return round(current_ma * FULL_CODE / full_ma)


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
    """Set the focal power [1/m]; it takes effect in focal power mode only, and is not answered."""
    return set_power_code(power_code(diopters, firmware))


def set_power_code(code: int) -> Request:
    """Set the focal power by its code."""
    if not -32768 <= code <= 32767:
        raise BadInput(f"focal power code {code} does not fit 16 bits")
    return Request(b"PwDA" + struct.pack(">hh", code, 0))


def set_window(low_celsius: float, high_celsius: float) -> Request:
    """Set the temperatures the lens will stay between; a narrow window guarantees a wide range of focal power."""
    if not low_celsius < high_celsius:
        raise BadInput(f"a temperature window from {low_celsius} to {high_celsius} degC is empty")
    return Request(b"PwTA" + struct.pack(">hh", round(high_celsius * 16), round(low_celsius * 16)), b"PT", 11)


def set_generator(upper_code: int, lower_code: int, frequency_hz: float) -> tuple[Request, Request, Request]:
    """Set the swing and frequency of the waves; none of the three is answered."""
    if frequency_hz < 0.1:
        raise BadInput(f"a frequency of {frequency_hz} Hz is below the driver's least, 0.1 Hz")
    return (
        Request(b"PwUA" + struct.pack(">hh", upper_code, 0)),
        Request(b"PwLA" + struct.pack(">hh", lower_code, 0)),
        Request(b"PwFA" + struct.pack(">I", round(frequency_hz * 1000))),
    )


def set_drift_gain(gain: float) -> Request:
    """Set how strongly slow drift is compensated, 0..5; 1 is usual."""
    if not 0 <= gain <= 5:
        raise BadInput(f"a drift gain of {gain} is outside 0..5")
    return Request(b"Ow" + struct.pack(">h", round(gain * 100)), b"Ow", 11)


def set_full_current(current_ma: float) -> Request:
    """Set the full current [mA]; this wears the driver's memory, which lasts for 100 000 writes."""
    return Request(b"CwMA" + struct.pack(">H", round(current_ma * 100)), b"CMA", 9, writes_memory=True)


def set_limits(lower_code: int, upper_code: int) -> tuple[Request, Request]:
    """Set the limits of the current; this wears the driver's memory, which lasts for 100 000 writes."""
    return (
        Request(b"CwUA" + struct.pack(">h", upper_code), b"CUA", 9, writes_memory=True),
        Request(b"CwLA" + struct.pack(">h", lower_code), b"CLA", 9, writes_memory=True),
    )


def missing(request: Request, received: bytes) -> int:
    """How many bytes must still be read before what was received is a whole reply or refusal."""
    if received[:1] == b"E" and not request.prefix.startswith(b"E"):
        return 6 - len(received)
    if received[:1] == b"N" and not request.prefix.startswith(b"N"):
        return 3 - len(received)
    return (request.reply_length or 6) - len(received) if received else 1


def parse(request: Request, received: bytes) -> bytes:
    """What a whole reply carries after its prefix.

    Raises DeviceRefused where the device refused, ProtocolError where the bytes are no reply to this request.
    """
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
    """What the bits of the first status byte say."""
    return tuple(text for bit, text in enumerate(STATUS) if flags >> bit & 1)


@dataclass(frozen=True)
class PowerRange:
    """What the driver answers about focal power: status bits, and the least and greatest [1/m] it guarantees."""

    status: int
    least: float
    greatest: float


def power_range(body: bytes, firmware: str) -> PowerRange:
    """The range in an answer to the focal power mode, the temperature window or the drift gain."""
    status, greatest, least = struct.unpack(">Bhh", body)
    return PowerRange(status, power_of(least, firmware), power_of(greatest, firmware))


def signed(body: bytes) -> int:
    """The signed number a body of two bytes holds."""
    return struct.unpack(">h", body)[0]

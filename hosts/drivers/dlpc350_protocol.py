"""Messages of TI's DLPC350 (LightCrafter 4500) over USB HID; the DLPC900 differs only in `dlpc900_protocol`."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from vamgpu.errors import BadInput, DeviceRefused, ProtocolError

VENDOR = 0x0451
REPORT = 64
READ, REPLY, REFUSED = 0x80, 0x40, 0x20
DISPLAY_MODE, SOURCE, TRIGGER_MODE, DISPLAY = 0x1A1B, 0x1A22, 0x1A23, 0x1A24
TIMES, SEQUENCE, MAILBOX_PLACE, MAILBOX, MAILBOX_DATA = 0x1A29, 0x1A31, 0x1A32, 0x1A33, 0x1A34
VALIDATE, LED_ENABLE, LED_CURRENTS, MAIN_STATUS = 0x1A1A, 0x1A07, 0x0B01, 0x1A0C
PARKED, RUNNING = 1, 2  # bits of the main status
SHORTEST_US = {1: 235, 2: 700, 3: 1570, 4: 1700, 5: 2000, 6: 2500, 7: 4500, 8: 8333}  # by bits
DARK_US = 230  # between exposure and period, unless they are equal
COLORS = ("red", "green", "blue")  # bits 0..2 of a set of LEDs
CHANNELS = {1: 0, 0: 1, 2: 2}  # channel of a video frame (0 red, 1 green, 2 blue) → its place among patterns
BUSY = 0x80
INVALID = (
    "exposure or period",
    "number of a pattern",
    "trigger out while it is already high",
    "missing black after a pattern",
    "period less than exposure and 230 us",
)


def frame(command: int, data: bytes = b"", sequence: int = 0, read: bool = False) -> bytes:
    """The reports of a command with a reply."""
    size = len(data) + 2
    head = bytes([REPLY | (READ if read else 0), sequence & 0xFF, size & 0xFF, size >> 8])
    body = head + bytes([command & 0xFF, command >> 8]) + data
    return body + bytes(-len(body) % REPORT)


def parse_reply(raw: bytes, sequence: int, what: str) -> bytes:
    """Return a reply's data; DeviceRefused if the controller rejected ``what``."""
    size = int.from_bytes(raw[2:4], "little") if len(raw) >= 4 else REPORT
    if size > len(raw) - 4 or raw[1] != sequence & 0xFF:
        raise ProtocolError(f"{bytes(raw[:8])!r} is not an answer to {what}; unplug and replug the projector")
    if raw[0] & REFUSED:
        raise DeviceRefused(f"the projector refused {what}", "nack")
    return bytes(raw[4 : 4 + size])


class Step(NamedTuple):
    """A command, or without data a query that is repeated until the bits of ``mask`` are ``value``."""

    command: int
    data: bytes | None
    what: str
    mask: int = 0
    value: int = 0
    faults: Callable[[int], tuple[str, ...]] = lambda status: ()  # in the answer to the query


class Dlpc(NamedTuple):
    """A kind of controller."""

    name: str
    product: int
    shortest_us: dict[int, int]  # exposure by bits
    rest_us: int  # time of a video frame that its patterns leave
    inverted: bool  # code 255 is an LED without current
    # steps that show patterns of video frames: channels, bits, exposure [us], period [us], bits of the LEDs
    video: Callable[[tuple[int, ...], int, int, int, int], tuple[Step, ...]]


def times(
    bits: int, count: int, exposure_us: int, period_us: int, refresh_us: int,
    shortest_us: dict[int, int] = SHORTEST_US,
) -> bytes:  # fmt: skip
    """Exposure and period of ``count`` patterns in a video frame; BadInput if they cannot be shown."""
    if bits not in shortest_us or exposure_us < shortest_us[bits]:
        raise BadInput(f"patterns of {bits} bits cannot be shown for {exposure_us} us; shortest: {shortest_us}")
    if exposure_us != period_us and exposure_us > period_us - DARK_US:
        raise BadInput(
            f"an exposure of {exposure_us} us does not fit a period of {period_us} us; make them equal, or the "
            f"exposure at most {period_us - DARK_US} us"
        )
    if count * period_us > refresh_us:
        raise BadInput(f"{count} patterns of {period_us} us do not fit a video frame of {refresh_us} us; show fewer")
    return exposure_us.to_bytes(4, "little") + period_us.to_bytes(4, "little")


def patterns(channels: tuple[int, ...], bits: int, leds: int) -> bytes:
    """Encode a video frame's patterns in order; the first waits for the vertical blanking."""
    if bits not in (7, 8) or not channels or not set(channels) <= set(CHANNELS):
        raise BadInput(f"channels {channels} of {bits} bits; expected channels of 0, 1 and 2, with 7 or 8 bits")
    table = bytearray()
    for number, channel in enumerate(channels):
        trigger, flags = (1, 0b100) if number == 0 else (3, 0)
        table += bytes([trigger | CHANNELS[channel] << 2, bits | leds << 4, flags])
    return bytes(table)


def sequence(count: int) -> bytes:
    """The settings of a table of ``count`` patterns that repeats with each video frame."""
    return bytes([count - 1, 1, count - 1, 0])


def faults(status: int) -> tuple[str, ...]:
    """Faults that the controller finds in a table."""
    return tuple(text for bit, text in enumerate(INVALID) if status >> bit & 1)


def video(channels: tuple[int, ...], bits: int, exposure_us: int, period_us: int, leds: int) -> tuple[Step, ...]:
    """Steps that show patterns of each video frame, checked by the projector before they start."""
    return (
        Step(DISPLAY, b"\0", "the stop"),
        Step(DISPLAY_MODE, b"\1", "the pattern mode"),
        Step(SOURCE, b"\0", "patterns from video"),
        Step(SEQUENCE, sequence(len(channels)), "the number of patterns"),
        Step(TRIGGER_MODE, b"\0", "the trigger by vertical blanking"),
        Step(TIMES, exposure_us.to_bytes(4, "little") + period_us.to_bytes(4, "little"), "exposure and period"),
        Step(MAILBOX, b"\2", "the table's opening"),
        Step(MAILBOX_PLACE, b"\0", "the table's place"),
        Step(MAILBOX_DATA, patterns(channels, bits, leds), "the table"),
        Step(MAILBOX, b"\0", "the table's closing"),
        Step(VALIDATE, b"", "the check"),
        Step(VALIDATE, None, "the check's result", BUSY, 0, faults),
        Step(DISPLAY, b"\2", "the start"),
    )


DLPC350 = Dlpc("LightCrafter 4500", 0x6401, SHORTEST_US, 0, True, video)

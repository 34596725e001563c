"""Patterns of TI's DLPC900, the controller of LightCrafters 6500 and 9000, in video pattern mode."""

from __future__ import annotations

from vamgpu.errors import BadInput
from vamgpu.hosts.drivers.dlpc350_protocol import CHANNELS, DISPLAY, DISPLAY_MODE, Dlpc, Step

SOURCE, RECEIVER, STATUS, ERROR, DEFINITION, CONFIGURATION = 0x1A00, 0x1A01, 0x1A0C, 0x0100, 0x1A34, 0x1A31
VIDEO, VIDEO_PATTERNS = b"\0", b"\2"  # display modes
RUNNING, LOCKED = 0b10, 0b1000  # bits of the status: patterns are shown, the cable's video is in step
SHORTEST_US = {1: 105, 2: 304, 3: 394, 4: 823, 5: 1215, 6: 1487, 7: 1998, 8: 4046}  # by bits
REST_US = 230  # two loads of the mirrors: black after the last pattern, and the wait for the next video frame
ERRORS = (
    "", "check sum of a batch file", "device failure", "unknown command", "controller does not match the mirrors",
    "command not allowed in this mode", "parameter", "item that is not there", "memory", "compression of an image",
    "number of a bit", "size of an image",
)  # fmt: skip


def definition(number: int, channel: int, bits: int, exposure_us: int, leds: int) -> bytes:
    """One pattern of a video frame; the first waits for the vertical blanking."""
    if bits not in SHORTEST_US or channel not in CHANNELS:
        raise BadInput(f"a pattern of {bits} bits of channel {channel}; expected 1 to 8 bits, and channel 0, 1 or 2")
    flags = 1 | bits - 1 << 1 | leds << 4 | (number == 0) << 7
    place = 8 * CHANNELS[channel] + 8 - bits  # first of its bits among the 24 of a video frame
    head = number.to_bytes(2, "little") + exposure_us.to_bytes(3, "little")
    return head + bytes([flags]) + bytes(4) + (place << 11).to_bytes(2, "little")


def _refusal(code: int) -> tuple[str, ...]:
    return (ERRORS[code] if code < len(ERRORS) else f"error {code}",) if code else ()


def video(channels: tuple[int, ...], bits: int, exposure_us: int, period_us: int, leds: int) -> tuple[Step, ...]:
    """Steps that show patterns of each video frame; patterns follow one another without dark time."""
    if period_us != exposure_us or not channels:
        raise BadInput(f"patterns of {exposure_us} us every {period_us} us; expected one or more, without dark time")
    return (
        Step(DISPLAY, b"\0", "the stop"),
        Step(DISPLAY_MODE, VIDEO, "the video mode"),
        Step(SOURCE, b"\x08", "the parallel port of 24 bits"),
        Step(RECEIVER, b"\1", "the HDMI receiver"),
        Step(STATUS, None, "a locked video signal", LOCKED, LOCKED),
        Step(DISPLAY_MODE, VIDEO_PATTERNS, "the video pattern mode"),
        Step(DISPLAY_MODE, None, "the video pattern mode", 0b11, 0b10),
        *(
            Step(DEFINITION, definition(number, channel, bits, exposure_us, leds), f"pattern {number}")
            for number, channel in enumerate(channels)
        ),
        Step(CONFIGURATION, len(channels).to_bytes(2, "little") + bytes(4), "the number of patterns"),
        Step(ERROR, None, "the check's result", faults=_refusal),
        Step(DISPLAY, b"\2", "the start"),
        Step(STATUS, None, "running patterns", RUNNING, RUNNING),
    )


DLPC900 = Dlpc("LightCrafter 6500 or 9000", 0xC900, SHORTEST_US, REST_US, False, video)

"""The LightCrafter 4500: its messages to the byte, and what it does when it fails."""

from __future__ import annotations

import pytest
from emulated_lightcrafter import EmulatedLightCrafter, parse_command

from vamgpu.errors import BadInput, DeviceLost, DeviceRefused, ProtocolError
from vamgpu.hosts.drivers import dlpc350_protocol as dlpc350
from vamgpu.hosts.drivers.lightcrafter import LightCrafter


def test_a_command_to_the_byte() -> None:
    raw = dlpc350.frame(dlpc350.TIMES, dlpc350.times(8, 2, 8333, 8333, 16_667), 5)
    assert raw[:14] == bytes.fromhex("40 05 0a 00 29 1a 8d 20 00 00 8d 20 00 00") and len(raw) == 64
    assert dlpc350.frame(dlpc350.VALIDATE, read=True)[:6] == bytes.fromhex("c0 00 02 00 1a 1a")
    assert dlpc350.patterns((1, 0), 8, 0b100) == bytes.fromhex("01 48 04 07 48 00")
    assert parse_command(raw).data == raw[6:14]
    with pytest.raises(ProtocolError, match="not an answer"):
        dlpc350.parse_reply(bytes(64), 5, "the check")


def test_two_patterns_of_each_video_frame_are_lit() -> None:
    device = EmulatedLightCrafter()
    pauses: list[float] = []
    with LightCrafter(device, pause=pauses.append) as projector:
        assert not device.lit
        projector.show_video((1, 0), 8, 8333, 8333, "blue")
        assert device.settings[dlpc350.SEQUENCE] == bytes([1, 1, 1, 0]) and len(pauses) == 2
        assert device.settings[dlpc350.DISPLAY_MODE] == b"\1" and not device.lit
        projector.drive(blue=1.0)
        assert device.settings[dlpc350.LED_CURRENTS] == bytes([255, 255, 0])
        projector.on()
        assert device.lit
        projector.off()
        projector.off()
        assert not device.lit
        projector.on()
    projector.close()
    assert not device.lit and device.closed and device.settings[dlpc350.DISPLAY] == b"\0"


def test_what_cannot_be_shown_is_refused() -> None:
    device = EmulatedLightCrafter(polls=0)
    projector = LightCrafter(device)
    for wrong in (
        ((1, 0), 8, 8000, 8333, "blue"),
        ((1, 0, 2), 8, 8333, 8333, "blue"),
        ((1,), 8, 8400, 8500, "blue"),
        ((1,), 8, 8333, 8333, "violet"),
        ((3,), 8, 8333, 8333, "blue"),
    ):
        with pytest.raises(BadInput):
            projector.show_video(*wrong)
    device.refuse = {dlpc350.MAILBOX_DATA}
    with pytest.raises(DeviceRefused, match="refused the table"):
        projector.show_video((1,), 8, 8333, 8333, "blue")
    device.refuse.clear()
    device.settings.clear()
    device._judge = lambda: 0b10001
    with pytest.raises(DeviceRefused, match="exposure or period, period less"):
        projector.show_video((1,), 8, 8333, 8333, "blue")
    assert device.settings[dlpc350.DISPLAY] == b"\0"


def test_a_late_answer_is_not_taken_for_the_next_one() -> None:
    device = EmulatedLightCrafter()
    projector = LightCrafter(device, pause=lambda seconds: None)
    device.late = 2
    for _ in range(2):
        with pytest.raises(DeviceLost, match="does not answer light on"):
            projector.on()
    projector.show_video((1,), 8, 8333, 8333, "blue")
    assert device.lit
    projector.inspect()
    projector.off()
    assert not device.lit and not device._out


def test_a_projector_that_is_gone_is_told() -> None:
    device = EmulatedLightCrafter(polls=10**6)
    projector = LightCrafter(device, pause=lambda seconds: None)
    with pytest.raises(DeviceLost, match="has not reached the check"):
        projector.show_video((1,), 8, 8333, 8333, "blue")
    device.silent = True
    with pytest.raises(DeviceLost, match="light on"):
        projector.on()
    device.unplugged = True
    with pytest.raises(DeviceLost, match="lost"):
        projector.off()
    projector.close()
    assert device.closed

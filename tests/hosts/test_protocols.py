"""Golden bytes of the protocols, and what garbage does to them."""

from __future__ import annotations

import re
from binascii import crc_hqx
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vamgpu import hosts
from vamgpu.errors import BadInput, DeviceRefused, ProtocolError
from vamgpu.hosts.drivers import controller_protocol as controller
from vamgpu.hosts.drivers import optotune_protocol as ld4
from vamgpu.hosts.drivers import projector as slots
from vamgpu.hosts.drivers import zaber_protocol as zaber
from vamgpu.hosts.drivers.optotune_protocol import crc16_arc
from vamgpu.hosts.drivers.zaber_protocol import lrc
from vamgpu.hosts.emulators import controller as emulated
from vamgpu.hosts.emulators.controller import RANGES, EmulatedController
from vamgpu.hosts.emulators.lens import LENGTHS

REQUESTS = [
    (ld4.FIRMWARE_TYPE, "48 00 36"),
    (ld4.VERSION, "56 80 3e"),
    (ld4.GET_STATUS, "53 72 bc d5"),
    (ld4.GET_TEMPERATURE, "54 43 41 b0 d0"),
    (ld4.FOCAL_POWER_MODE, "4d 77 43 41 56 76"),
    (ld4.set_window(20, 45), "50 77 54 41 02 d0 01 40 33 c1"),
    (ld4.set_window(20, 35), "50 77 54 41 02 30 01 40 32 37"),
    (ld4.set_power(1.0, "A"), "50 77 44 41 04 b0 00 00 31 a7"),
    (ld4.set_power(3.0, "A"), "50 77 44 41 06 40 00 00 30 2c"),
    (ld4.set_power(5.0, "A"), "50 77 44 41 07 d0 00 00 31 fd"),
    (ld4.GET_POWER, "50 72 44 41 00 00 00 00 64 70"),
    (ld4.GET_FULL_CURRENT, "43 72 4d 41 00 00 71 80"),
]
PUBLIC = [value for value in vars(ld4).values() if isinstance(value, ld4.Request)]


@pytest.mark.parametrize(("request_", "frame"), REQUESTS)
def test_the_lens_drivers_frames_are_the_makers(request_: ld4.Request, frame: str) -> None:
    assert request_.frame == bytes.fromhex(frame)
    assert crc16_arc(request_.frame) == 0, "a frame with its check sum is 0"
    name = max((known for known in LENGTHS if request_.frame.startswith(known)), key=len)
    assert LENGTHS[name] == len(request_.frame)


def test_every_check_sum_has_its_published_value() -> None:
    assert crc16_arc(b"123456789") == 0xBB3D
    assert controller.line_check(b"123456789") == 0x29B1
    assert lrc(b"\x01\x03\x04\x01\x00\x01") == 0xF6


def test_replies_are_read_by_length_though_they_hold_line_ends() -> None:
    body = b"CMA\x0d\x0a"
    reply = body + crc16_arc(body).to_bytes(2, "little") + b"\r\n"
    for received in range(len(reply)):
        assert ld4.missing(ld4.GET_FULL_CURRENT, reply[:received]) > 0
    assert ld4.missing(ld4.GET_FULL_CURRENT, reply) == 0
    assert ld4.parse(ld4.GET_FULL_CURRENT, reply) == bytes.fromhex("0d0a")


def test_golden_replies() -> None:
    ask_current = ld4.Request(b"Ar\0\0", b"A", 7)
    assert ld4.signed(ld4.parse(ask_current, bytes.fromhex("41 05 7a d2 a7 0d 0a"))) == 1402
    with pytest.raises(DeviceRefused, match="check sum") as refused:
        ld4.parse(ask_current, bytes.fromhex("45 01 f3 50 0d 0a"))
    assert refused.value.code == "E1"
    with pytest.raises(DeviceRefused):
        ld4.parse(ld4.GET_STATUS, b"N\r\n")


@pytest.mark.parametrize("number", [1, 2, 3, 4, 9])
def test_every_refusal_has_its_number_and_what_to_do(number: int) -> None:
    body = b"E" + bytes((number,))
    with pytest.raises(DeviceRefused, match=ld4.REFUSALS.get(number, "reason 9")) as refused:
        ld4.parse(ld4.GET_STATUS, body + crc16_arc(body).to_bytes(2, "little") + b"\r\n")
    assert refused.value.code == f"E{number}"


@given(st.binary(max_size=14))
def test_garbage_is_no_reply(garbage: bytes) -> None:
    with pytest.raises((ProtocolError, DeviceRefused)):
        ld4.parse(ld4.GET_FULL_CURRENT, garbage)


@given(st.integers(0, 8), st.integers(0, 7))
def test_one_wrong_bit_is_found(byte: int, bit: int) -> None:
    body = b"CMA\x72\x64"
    reply = bytearray(body + crc16_arc(body).to_bytes(2, "little") + b"\r\n")
    reply[byte] ^= 1 << bit
    with pytest.raises((ProtocolError, DeviceRefused)):
        ld4.parse(ld4.GET_FULL_CURRENT, bytes(reply))


def test_nothing_resets_the_lens_driver_or_wears_its_memory() -> None:
    payloads = [request.payload for request in PUBLIC]
    assert not any(payload.startswith((b"RESET", b"Zw", b"D", b"Cw")) for payload in payloads)


@given(st.floats(-5, 15.475))
def test_focal_powers_survive_their_code(diopters: float) -> None:
    for firmware in "AC":
        code = ld4.power_code(diopters, firmware)
        assert abs(ld4.power_of(code, firmware) - diopters) <= 0.0025 + 1e-9


def test_bad_values_never_become_frames() -> None:
    for build in (
        lambda: ld4.set_power(16.0, "A"),
        lambda: ld4.set_window(45, 20),
    ):
        with pytest.raises(BadInput):
            build()


def test_status_bits_have_names() -> None:
    assert ld4.status_texts(0) == ()
    assert ld4.status_texts(0b10000010) == ("lens memory missing or faulty", "outside the temperature window set")


def test_controller_lines_keep_their_words() -> None:
    line = controller.encode(7, "row", *controller.ControllerRow(3, 1000, None, 5000, 20000, 2).words())
    assert line.startswith(b"7 row 3 1000 - 5000 20000 2*") and line.endswith(b"\n")
    assert controller.check(line) == ("7", "row", "3", "1000", "-", "5000", "20000", "2")
    assert int(line[-5:-1], 16) == crc_hqx(line[:-6], 0xFFFF)


@given(st.integers(0, 30), st.integers(0, 7))
def test_one_wrong_bit_in_a_line_is_found(byte: int, bit: int) -> None:
    line = bytearray(controller.encode(12, "lease", 250))
    line[byte % (len(line) - 1)] ^= 1 << bit
    with pytest.raises(ProtocolError):
        controller.check(bytes(line))


@given(st.binary(max_size=60))
def test_garbage_is_no_controller_line(garbage: bytes) -> None:
    with pytest.raises(ProtocolError):
        controller.parse(garbage + b"#")


def test_stage_messages() -> None:
    def summed(text: str) -> bytes:
        return f"@{text}:{lrc(text.encode()):02X}\r\n".encode()

    assert zaber.command(1, 1, 4, "move abs 1000") == b"/01 1 04 move abs 1000:%02X\n" % lrc(b"01 1 04 move abs 1000")
    makers = b"/1 1 00 get pos:2C"
    assert lrc(makers[1:-3]) == 0x2C
    reply = zaber.parse(summed("01 1 04 OK BUSY WR 1234"))
    assert (reply.number, reply.busy, reply.warning, zaber.accept(reply, "get pos")) == (4, True, "WR", "1234")
    with pytest.raises(DeviceRefused, match="BADDATA"):
        zaber.accept(zaber.parse(summed("01 0 05 RJ IDLE -- BADDATA")), "move abs -1")
    with pytest.raises(DeviceRefused, match="FS"):
        zaber.accept(zaber.parse(summed("01 1 06 OK IDLE FS 0")), "move abs 1")
    wrong = summed("01 1 07 OK IDLE -- 0").replace(b"-- 0", b"-- 1")
    for bad in (b"", b"hello", wrong, summed("xx 1 07 OK IDLE -- 0"), summed("01 1 04 MAYBE IDLE -- 0")):
        with pytest.raises(ProtocolError):
            zaber.parse(bad)


def test_slots_keep_frames_apart_and_levels_in_place() -> None:
    rng = np.random.default_rng(0)
    first, second, third = rng.integers(0, 256, (3, 5, 7), dtype=np.uint8)
    frame = slots.compose([first, second], slots.TWO_OF_8)
    assert np.array_equal(frame[..., 1], first) and np.array_equal(frame[..., 0], second) and not frame[..., 2].any()
    frame = slots.compose([first, second, third], slots.THREE_OF_7)
    assert not (frame & 1).any()
    for channel, own in zip((1, 0, 2), (first, second, third), strict=True):
        assert np.abs((frame[..., channel] >> 1) / 127 - own / 255).max() <= 0.5 / 127 + 1e-9
    with pytest.raises(BadInput):
        slots.compose([first], slots.TWO_OF_8)


def test_protocol_emulator_and_sketch_know_the_same_verbs() -> None:
    folder = Path(hosts.__file__).parent / "firmware" / "controller"
    page = (folder / "PROTOCOL.md").read_text(encoding="utf-8")
    verbs = set(re.findall(r"\n\| ([a-z]+) \|", page.partition("|---|")[2]))
    sketch = "".join(file.read_text(encoding="utf-8") for file in sorted(folder.glob("*.[hi]*")))
    assert len(verbs) == 18
    counts = {verb: int(words) for verb, words in re.findall(r'\{"(\w+)", (\d)\}', sketch)}
    assert verbs == set(counts) and counts == {"mode": 1} | {verb: len(each) for verb, each in RANGES.items()}
    assert verbs == {name.removeprefix("_do_") for name in dir(EmulatedController) if name.startswith("_do_")}
    assert f'"{controller.NAME} {controller.VERSION} "' in sketch
    for name in ("LONGEST_LINE", "LONGEST_LEASE_MS", "FASTEST", "STEEPEST"):
        assert f" {name} = {getattr(controller, name)};" in sketch
        assert getattr(emulated, name) == getattr(controller, name)

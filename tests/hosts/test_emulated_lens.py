"""The emulated lens driver against golden bytes and known physics, without the driver."""

from __future__ import annotations

import numpy as np
import pytest

from vamgpu.hosts.emulators.lens import EmulatedLens, LensModel
from vamgpu.hosts.emulators.line import Cable

MILLI, SECOND = 1_000_000, 1_000_000_000


def _ask(lens: EmulatedLens, frame: str | bytes, now: int) -> bytes:
    lens.receive(bytes.fromhex(frame) if isinstance(frame, str) else frame, now)
    return lens.take(now + 50 * MILLI)


def test_lens_golden_bytes() -> None:
    lens = EmulatedLens(celsius=27.125)
    assert _ask(lens, b"Start", 0) == b"Ready\r\n"
    assert _ask(lens, "48 00 36", MILLI)[:2] == b"HA"
    assert _ask(lens, "54 43 41 b0 d0", 200 * MILLI)[:5] == bytes.fromhex("54 43 41 01 b2")
    assert _ask(lens, "54 43 41 b0 d1", 300 * MILLI) == bytes.fromhex("45 01 f3 50 0d 0a")
    assert _ask(lens, "50 77 44 41 04 b0 00 00 31 a7", 400 * MILLI) == b"" and lens.power_code == 1200
    assert _ask(lens, b"Start", 700 * MILLI) == b"Ready\r\n"
    assert lens.power_code == 0, "the handshake resets the power"


def test_lens_errors() -> None:
    lens = EmulatedLens()
    assert _ask(lens, b"?!", 0)[:2] == b"E\x03"
    assert _ask(lens, b"RESET", 100 * MILLI)[:2] == b"E\x03"
    old = EmulatedLens(legacy=True)
    assert _ask(old, "54 43 41 b0 d1", 0) == b"N\r\n"
    blind = EmulatedLens(sensor=False)
    assert _ask(blind, "4d 77 43 41 56 76", 0)[:2] == b"E\x04"
    assert _ask(blind, "54 43 41 b0 d0", 100 * MILLI)[3:5] == b"\x0f\xff"
    half = EmulatedLens()
    half.receive(b"PwDA\x05", 0)
    assert half.due() == 20 * MILLI
    half.advance(20 * MILLI)
    assert half.take(50 * MILLI)[:2] == b"E\x01"
    assert _ask(half, "50 77 44 41 04 b0 00 00 31 a7", 60 * MILLI) == b"" and half.power_code == 1200


def _focusing(**options: object) -> EmulatedLens:
    lens = EmulatedLens(LensModel(**options))  # type: ignore[arg-type]
    _ask(lens, "50 77 54 41 02 d0 01 40 33 c1", 0)
    _ask(lens, "4d 77 43 41 56 76", 100 * MILLI)
    return lens


def test_the_lens_settles_as_a_damped_oscillator() -> None:
    lens = _focusing(natural_hz=150.0, damping=0.5)
    start = SECOND
    lens.receive(bytes.fromhex("50 77 44 41 04 b0 00 00 31 a7"), start)
    times = np.arange(0, 40 * MILLI, 10_000)
    power = np.array([lens.power(start + int(t)) for t in times])
    t, omega = times * 1e-9, 2 * np.pi * 150
    y = v = 0.0
    wanted = []
    for _ in t:
        wanted.append(y)
        for _ in range(20):
            step = 10e-6 / 20
            a = omega**2 * (1 - y) - 2 * 0.5 * omega * v
            v += step * a
            y += step * v
    assert np.abs(power - wanted).max() < 2e-3
    overshoot = np.exp(-np.pi * 0.5 / np.sqrt(1 - 0.25))
    assert power.max() == pytest.approx(1 + overshoot, abs=1e-3)
    assert lens.power(start + SECOND) == pytest.approx(1.0, abs=1e-9)
    lens.receive(bytes.fromhex("50 77 44 41 06 40 00 00 30 2c"), start + SECOND)
    assert lens.power(start + 3 * MILLI) == power[300], "the past does not change"


def test_a_cable_takes_the_time_of_its_bytes() -> None:
    lens = _focusing()
    cable = Cable(lens, 38400)
    cable.send(bytes.fromhex("50 77 44 41 04 b0 00 00 31 a7"), SECOND)
    assert cable.due() == SECOND + 260_417
    cable.advance(SECOND + 2_604_169)
    assert lens.power_code != 1200
    cable.advance(SECOND + 2_604_170)
    assert lens.power_code == 1200

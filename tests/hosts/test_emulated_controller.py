"""The emulated controller, by lines of the tests' own making."""

from __future__ import annotations

from binascii import crc_hqx

import numpy as np
import pytest

from vamgpu.hosts.emulators.clock import VirtualClock
from vamgpu.hosts.emulators.controller import EmulatedController

MILLI, SECOND = 1_000_000, 1_000_000_000


class _Host:
    """Writes lines of its own making, so that the codec cannot hide a mistake."""

    def __init__(self) -> None:
        self.machine, self.clock, self.number = EmulatedController(), VirtualClock(), 0
        self.clock.attach(self.machine)
        self.lights: list[tuple[int, int]] = []
        self.triggers: list[int] = []
        self.frames: list[tuple[int, bytes]] = []
        self.machine.on_light = lambda channels, at: self.lights.append((channels, at))
        self.machine.on_trigger = self.triggers.append
        self.machine.on_lens = lambda frame, at: self.frames.append((at, frame))
        self.ask("hello")

    def ask(self, text: str, number: int | None = None) -> str:
        self.number = number if number is not None else self.number + 1
        body = f"{self.number} {text}".encode()
        self.machine.receive(body + b"*%04X\n" % crc_hqx(body, 0xFFFF), self.clock.now())
        lines = self.machine.take(self.clock.now() + MILLI).split(b"\n")
        return next((line.decode()[:-5].split(" ", 1)[1] for line in lines if line[:1].isdigit()), "")

    def ready(self, lease_ms: int = 1000) -> None:
        assert self.ask(f"lease {lease_ms}") == "ok" and self.ask("arm") == "ok"


def test_light_needs_a_lease_and_goes_off_with_it() -> None:
    host = _Host()
    assert host.ask("light 1") == "no armed"
    assert host.ask("arm") == "no lease"
    host.ready(250)
    assert host.ask("light 3") == "ok"
    for _ in range(10):
        host.clock.sleep(200 * MILLI)
        assert host.ask("lease 250") == "ok"
    host.clock.sleep(SECOND)
    assert host.lights == [(3, 0), (0, 2250 * MILLI)]
    assert host.ask("light 1") == "no armed"
    assert host.ask("stat").startswith("ok fault") and host.ask("stat").endswith(" lease")


def test_an_open_interlock_closes_the_light() -> None:
    host = _Host()
    host.ready()
    host.ask("light 1")
    host.clock.sleep(5 * MILLI)
    host.machine.open_interlock(5 * MILLI)
    assert host.lights[-1] == (0, 5 * MILLI)
    host.ask("lease 1000")
    assert host.ask("arm") == "no interlock"


def test_a_line_sent_twice_acts_once_and_a_broken_one_not_at_all() -> None:
    host = _Host()
    host.ready()
    assert host.ask("row 0 1000 - 0 100 1") == "ok 255 1"
    assert host.ask("row 0 1000 - 0 100 1", host.number) == "ok 255 1"
    assert host.ask("row 0 1000 - 0 100 1") == "no order"
    host.machine.receive(b"9 light 1*0000\n", 0)
    assert host.machine.light == 0 and host.machine.take(MILLI).startswith(b"? ")


def test_rows_act_at_their_times_with_lens_trigger_and_light() -> None:
    host = _Host()
    host.ready()
    for i in range(4):
        host.ask(f"row {i} {10_000 * i + 1000} {1200 if i % 2 else '-'} 2000 3000 {1 + i % 2}")
    host.ask("end 4")
    host.ask("go 5")
    host.clock.sleep(SECOND // 2)
    assert host.triggers == [(10 * i + 3) * MILLI for i in range(4)]
    golden = bytes.fromhex("50 77 44 41 04 b0 00 00 31 a7")
    assert host.frames == [(11 * MILLI, golden), (31 * MILLI, golden)]
    on = [(10 * i + 3) * MILLI for i in range(4)]
    wanted = [entry for i, t in enumerate(on) for entry in ((1 + i % 2, t), (0, t + 3 * MILLI))]
    assert host.lights == wanted
    assert host.ask("stat").startswith("ok done 4 4 0 256")


def test_rows_by_steps_follow_the_web_wherever_it_is() -> None:
    host = _Host()
    host.ready()
    host.ask("mode steps")
    host.ask("ramp 1000")
    for i in range(5):
        host.ask(f"row {i} {100 * (i + 1)} - 0 1000 1")
    host.ask("go 5")
    host.ask("move 500000")
    host.clock.sleep(900 * MILLI)
    web = host.machine.web
    assert [web.position(at) for at in host.triggers] == pytest.approx([100, 200, 300], abs=1e-3)
    assert host.triggers[0] == pytest.approx(np.sqrt(0.2) * SECOND, abs=2000)


def test_a_web_that_slips_forward_acts_its_rows_at_once() -> None:
    host = _Host()
    host.ready()
    host.ask("mode steps")
    for i in range(3):
        host.ask(f"row {i} {100 * (i + 1)} - 0 1000 1")
    host.ask("go 5")
    host.clock.sleep(10 * MILLI)
    host.machine.web.set_position(host.clock.now(), 250.0)
    host.clock.sleep(10 * MILLI)
    assert host.triggers == [10 * MILLI, 10 * MILLI + 50_000], "triggers are told apart"


def test_a_row_that_comes_late_stays_dark() -> None:
    host = _Host()
    host.ready()
    host.ask("row 0 1000 - 0 100 1")
    host.ask("go 5")
    host.clock.sleep(20 * MILLI)
    host.ask("row 1 10000 - 0 100 1")
    host.clock.sleep(20 * MILLI)
    assert len([1 for channels, _ in host.lights if channels]) == 1 and len(host.triggers) == 2
    assert host.ask("stat").split()[4] == "1"


def test_stop_darkens_before_the_web_rests() -> None:
    host = _Host()
    host.ready()
    host.ask("ramp 1000")
    host.ask("move 100000")
    host.clock.sleep(SECOND)
    host.ready()
    host.ask("light 1")
    host.ask("stop")
    assert host.lights[-1] == (0, SECOND) and host.machine.web.velocity(SECOND) == 100
    assert host.machine.web.velocity(SECOND + 100 * MILLI) == 0

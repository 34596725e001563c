"""The sketch and the emulated controller, each with the driver, hold the same conversations."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import pytest

from vamgpu.hosts.drivers.controller import Controller
from vamgpu.hosts.drivers.controller_protocol import ControllerRow
from vamgpu.hosts.drivers.wire import Wire
from vamgpu.hosts.emulators.controller import EmulatedController
from vamgpu.hosts.emulators.line import VirtualPort

MILLI, SECOND = 1_000_000, 1_000_000_000
TURN = 30_000
"""How far apart the same events may be: turns of the sketch's loop."""
NewBoard = Callable[..., Any]
NewConversation = Callable[..., Any]
Both = Callable[..., tuple[Any, Any]]


def _allow(emulated: Any, at_ms: float, lease_ms: int = 1000) -> None:
    emulated.ask(at_ms, "lease", lease_ms)
    emulated.ask(at_ms + 10, "arm")


def test_who_answers_is_the_same(both: Both) -> None:
    emulated, real = both(lambda emulated: None)
    for name in ("capacity", "channels"):
        assert getattr(real.driver, name) == getattr(emulated.driver, name)


def test_light_needs_a_lease_and_goes_off_with_it(both: Both) -> None:
    def scenario(emulated: Any) -> None:
        assert emulated.ask(100, "light", 1) == "armed"
        assert emulated.ask(110, "arm") == "lease"
        assert emulated.ask(120, "lease", 0) == emulated.ask(130, "lease", 1001) == "range"
        _allow(emulated, 140, 200)
        assert emulated.ask(160, "light", 4) == "range"
        assert emulated.ask(170, "light", 3) == ()
        for at in range(200, 1000, 100):
            emulated.ask(at, "lease", 200)
        seen = emulated.status(1200)
        assert (seen.state, seen.fault, seen.light, seen.armed, seen.lease_ms) == ("fault", "lease", 0, False, 0)
        assert emulated.ask(1210, "light", 1) == "armed"
        _allow(emulated, 1220)
        assert emulated.status(1240).state == "armed"

    emulated, _ = both(scenario)
    assert emulated.lights == [(3, 170 * MILLI), (0, 1100 * MILLI)]


def test_an_open_interlock_darkens_and_refuses(both: Both) -> None:
    def scenario(emulated: Any) -> None:
        _allow(emulated, 100)
        emulated.ask(120, "light", 1)
        emulated.clock.sleep_until(150 * MILLI)
        emulated.machine.open_interlock(emulated.clock.now())
        emulated.ask(160, "lease", 1000)
        assert emulated.ask(170, "arm") == "interlock"
        seen = emulated.status(180)
        assert (seen.fault, seen.interlock_closed, seen.light) == ("interlock", False, 0)

    both(scenario)


def test_rows_act_in_time_with_lens_trigger_and_light(both: Both) -> None:
    def scenario(emulated: Any) -> None:
        _allow(emulated, 100)
        for i in range(6):
            emulated.ask(
                120 + 10 * i, "row", i, 20_000 * i + 1500, -1200 if i % 2 else "-", 2000, 5000 * (i != 3), 1 + i % 3
            )
        assert emulated.ask(190, "row", 7, 1, "-", 0, 0, 1) == "order"
        for wrong in ((6, -1, "-", 0, 0, 1), (6, 1, 32768, 0, 0, 1), (6, 1, "-", 2**31, 0, 1), (6, 1, "-", 0, 0, 4)):
            assert emulated.ask(emulated.clock.now() // MILLI + 10, "row", *wrong) == "range"
        emulated.ask(250, "end", 6)
        emulated.ask(260, "go", 5)
        assert (
            emulated.ask(270, "go", 5) == emulated.ask(280, "mode", "steps") == emulated.ask(290, "zero", 7) == "state"
        )
        seen = emulated.status(320)
        assert (seen.state, seen.row, seen.shown, seen.free) == ("running", 3, 3, 253)
        assert emulated.status(365).state == "running", "while the last frame is lit"
        assert emulated.status(400).state == "done"

    emulated, real = both(scenario)
    assert len(real.triggers) == 6 and len(emulated.lights) == 10
    assert real.frames[0][1] == bytes.fromhex("50774441fb500000") + real.frames[0][1][-2:]
    assert ("done", "6") in real.driver.events


def test_a_row_that_comes_late_stays_dark(both: Both) -> None:
    def scenario(emulated: Any) -> None:
        _allow(emulated, 100)
        emulated.ask(120, "go", 5)
        emulated.ask(150, "row", 0, 10_000, 1000, 1000, 5000, 1)
        emulated.ask(160, "row", 1, 50_000, "-", 1000, 5000, 1)
        seen = emulated.status(190)
        assert (seen.late, seen.shown) == (1, 2)

    emulated, real = both(scenario)
    assert [channels for channels, _ in real.lights] == [1, 0]
    assert emulated.triggers[0] == 151 * MILLI


def test_a_full_queue_says_so(both: Both) -> None:
    def scenario(emulated: Any) -> None:
        for i in range(256):
            assert emulated.ask(100 + 10 * i, "row", i, i, "-", 0, 0, 0) == (str(255 - i), str(i + 1))
        assert emulated.ask(2700, "row", 256, 256, "-", 0, 0, 0) == "full"

    both(scenario)


@pytest.mark.parametrize(("told", "shown"), [(0, 3), (3, 3), (4, 4), (9, 9)])
@pytest.mark.parametrize("at_ms", [271.25, 274.5, 279.75])
def test_the_end_may_be_told_again_while_rows_run(both: Both, told: int, shown: int, at_ms: float) -> None:
    """At 271 ms row 2 waits for its delay, at 274 ms it is lit, at 280 ms it is over; it is never cut short."""

    def scenario(emulated: Any) -> None:
        _allow(emulated, 100)
        for i in range(9):
            emulated.ask(120 + 10 * i, "row", i, 20_000 * i, "-", 2000, 5000, 1)
        emulated.ask(220, "end", 6)
        emulated.ask(230, "go", 5)
        emulated.ask(at_ms, "end", told)
        seen = emulated.status(430)
        assert (seen.state, seen.shown, seen.free) == ("done", shown, 256 - (9 - shown))

    _, real = both(scenario)
    lit = [b - a for (_, a), (_, b) in zip(real.lights[::2], real.lights[1::2], strict=True)]
    assert len(lit) == shown and all(abs(each - 5 * MILLI) <= TURN for each in lit)


def test_rows_by_steps_follow_the_web(both: Both) -> None:
    seen: list[list[Any]] = []

    def scenario(emulated: Any) -> None:
        _allow(emulated, 100)
        emulated.ask(120, "mode", "steps")
        assert emulated.ask(125, "mode", "miles") == emulated.ask(130, "ramp", 0) == "range"
        emulated.ask(140, "ramp", 20_000)
        for i in range(8):
            emulated.ask(150 + 10 * i, "row", i, 400 * (i + 1), "-", 500, 10_000, 1)
        emulated.ask(240, "end", 8)
        emulated.ask(250, "go", 5)
        emulated.ask(260, "move", 5_000_000)
        emulated.ask(560, "lease", 1000)
        emulated.ask(800, "move", -2_000_000)
        seen.append([emulated.status(at) for at in (850, 1100, 2000)])

    _, real = both(scenario, 500_000)
    assert len(real.triggers) == 6
    for one, other in zip(*seen, strict=True):
        assert abs(one.position - other.position) <= 3 and abs(one.speed - other.speed) <= 20_000
        assert (one.state, one.row, one.shown) == (other.state, other.row, other.shown)


def test_a_ramp_that_changes_under_way_goes_on_with_the_new_one(both: Both) -> None:
    def scenario(emulated: Any) -> None:
        emulated.ask(100, "ramp", 1000)
        emulated.ask(200, "move", 900_000)
        assert abs(emulated.status(299).speed - 100_000) <= 5000
        emulated.ask(399, "ramp", 5000)
        assert abs(emulated.status(449).speed - 450_000) <= 25_000
        emulated.ask(499, "hello")
        assert emulated.status(599).speed == 900_000

    both(scenario)


def test_speeds_and_ramps_out_of_range_are_refused(both: Both) -> None:
    def scenario(emulated: Any) -> None:
        at = itertools.count(100, 10)
        for verb, wrong in (("move", (200_000_001, -200_000_001, 9 * 10**17)), ("ramp", (-1, 100_000_001, 9 * 10**17))):
            assert all(emulated.ask(next(at), verb, value) == "range" for value in wrong)
        for verb, right in (("ramp", (1, 100_000_000)), ("move", (200_000_000, -200_000_000, 0))):
            assert all(emulated.ask(next(at), verb, value) == () for value in right)
        seen = emulated.status(next(at))
        assert seen.speed == 0 and abs(seen.position - 400) <= 60
        emulated.ask(next(at), "hello")
        emulated.ask(next(at), "move", 1_000_000)
        assert abs(emulated.status(next(at) - 6).speed - 800_000) <= 5000, (
            "hello forgets the ramp: 200 microsteps/s a ms"
        )

    both(scenario)


@pytest.mark.parametrize("close", ["lease", "interlock"])
def test_light_is_closed_in_time_at_the_greatest_speed(both: Both, close: str) -> None:
    def scenario(emulated: Any) -> None:
        emulated.ask(80, "ramp", 100_000_000)
        emulated.ask(90, "move", 200_000_000)
        _allow(emulated, 100, 250)
        emulated.ask(120, "light", 1)
        if close == "interlock":
            emulated.clock.sleep_until(200 * MILLI)
            emulated.machine.open_interlock(emulated.clock.now())
        assert emulated.status(400).fault == close
        assert abs(emulated.status(590).position - 99_800) <= 100

    emulated, real = both(scenario, 100_000)
    assert [channels for channels, _ in real.lights] == [1, 0]
    assert abs(real.lights[1][1] - (350 if close == "lease" else 200) * MILLI) <= 100_000


def test_steady_light_does_not_outlive_what_closed_it(both: Both) -> None:
    def scenario(emulated: Any) -> None:
        _allow(emulated, 100)
        emulated.ask(120, "light", 2)
        emulated.ask(130, "row", 0, 10_000, "-", 0, 5000, 1)
        emulated.ask(140, "disarm")
        _allow(emulated, 150)
        emulated.ask(170, "go", 5)
        assert emulated.status(182).light == 1 and emulated.status(190).light == 0

    both(scenario)


def test_stop_darkens_and_drops(both: Both) -> None:
    def scenario(emulated: Any) -> None:
        _allow(emulated, 100)
        emulated.ask(120, "move", 1_000_000)
        emulated.ask(130, "row", 0, 0, "-", 0, 100_000, 2)
        emulated.ask(140, "go", 5)
        emulated.ask(160, "stop")
        seen = emulated.status(200)
        assert (seen.light, seen.row, seen.free, seen.shown, seen.speed, seen.armed) == (0, 0, 256, 1, 0, False)
        assert emulated.ask(260, "dance") == "verb"
        assert (
            emulated.ask(270, "power", 2, 0)
            == emulated.ask(280, "power", 0, 65536)
            == emulated.ask(285, "power", 1)
            == "range"
        )
        emulated.ask(290, "power", 1, 4321)

    _, real = both(scenario)
    assert real.machine.powers == [65535, 4321]


def test_what_was_shown_survives_the_host(conversation_with: NewConversation, new_board: NewBoard) -> None:
    for machine in (new_board(), EmulatedController()):
        emulated = conversation_with(machine)
        _allow(emulated, 100, 150)
        for i in range(9):
            emulated.ask(120 + 8 * i, "row", i, 20_000 * i, "-", 0, 5000, 1)
        emulated.ask(195, "move", 2_000_000)
        emulated.ask(205, "go", 5)
        emulated.clock.sleep_until(SECOND)
        again = Controller(Wire(VirtualPort(machine, emulated.clock, 0.05), "the controller"))
        seen = again.status()
        assert (seen.state, seen.row, seen.free, seen.shown, seen.play) == ("idle", 0, 256, 3, 5)
        assert seen.position >= 1580 and seen.zero == 0
        again.move(0.0)
        again.zero(4711)
        seen = Controller(Wire(VirtualPort(machine, emulated.clock, 0.05), "the controller")).status()
        assert (seen.zero, seen.shown, seen.play) == (4711, 3, 5) and seen.position < 1580
        again.go(6)
        seen = again.status()
        assert (seen.shown, seen.play, seen.light) == (0, 6, 0), "no rows of the first host"


def test_damaged_lines_are_asked_for_again_and_act_once(
    conversation_with: NewConversation, new_board: NewBoard
) -> None:
    for way in ("drop_in", "flip_in", "drop_out", "flip_out"):
        for byte in range(0, 24, 5):
            emulated = conversation_with(new_board(), 20)
            count = emulated.faults._count["in" if way.endswith("in") else "out"]
            setattr(emulated.faults, way, frozenset({count + byte}))
            free = [emulated.driver.row(ControllerRow(i, 1000 * i, 1000 + i, 0, 100)) for i in range(4)]
            assert free == [255, 254, 253, 252], (way, byte)

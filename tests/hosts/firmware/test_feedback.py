"""Encoder, index mark and homing: the sketch and the emulated controller measure alike, and see a motor that stalls."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from vamgpu.errors import BadInput
from vamgpu.hosts.drivers.controller import Encoder, Index

MILLI = 1_000_000
EDGE = 8  # microsteps of a count of the emulated encoder; the sketch's board has the same
MARK, ROUND = 500, 3200  # where its mark comes first, and how far it is from mark to mark
Both = Callable[..., tuple[Any, Any]]


def _moving(emulated: Any, speed: int = 4000, encoder: int = 40, index: int = 0) -> None:
    """Lit, and moved from 130 ms on; limits in microsteps, 0 for what is not there."""
    emulated.ask(90, "encoder", int(encoder > 0), EDGE, encoder)
    emulated.ask(100, "index", int(index > 0), ROUND, index)
    emulated.ask(110, "lease", 1000)
    emulated.ask(120, "arm")
    emulated.ask(130, "move", 1000 * speed)
    emulated.ask(140, "light", 1)


def test_what_is_measured_follows_what_is_stepped(both: Both) -> None:
    seen: list[list[Any]] = []

    def scenario(emulated: Any) -> None:
        _moving(emulated, index=20)
        found = [emulated.status(300)]
        emulated.ask(900, "lease", 1000)
        found.append(emulated.status(1500))
        emulated.ask(1510, "move", 0)
        emulated.ask(1600, "zero", 9)
        found.append(emulated.status(1610))
        seen.append(found)

    both(scenario)
    for one, other in zip(*seen, strict=True):
        assert abs(one.position - other.position) <= 3 and abs(one.measured - other.measured) <= EDGE + 3
        assert (one.marks, one.light, one.fault) == (other.marks, other.light, other.fault)
        assert 0 <= one.position - one.measured < EDGE + 1 and not one.astray
    assert [each.marks for each in seen[0]] == [1, 2, 2] and seen[0][1].light == 1
    assert seen[0][2].measured == seen[0][2].position == 0


@pytest.mark.parametrize("speed", [500, 4000, 60_000])
def test_a_motor_that_stalls_is_dark_within_the_limit(both: Both, speed: int) -> None:
    def scenario(emulated: Any) -> None:
        _moving(emulated, speed)
        emulated.clock.sleep_until(400 * MILLI)
        emulated.machine.stall(emulated.clock.now())
        seen = emulated.status(700)
        assert (seen.state, seen.fault, seen.light, seen.armed) == ("fault", "stall", 0, False)
        emulated.ask(720, "lease", 1000)
        assert emulated.ask(730, "arm") == "stall"
        emulated.ask(740, "zero", 9)
        assert emulated.ask(750, "arm") == ("stall" if speed > 4000 else ())

    emulated, real = both(scenario, 100_000 + round((EDGE + 1) * 1e9 / speed))  # a count may just have come, or come
    dark = next(at for channels, at in emulated.lights if not channels)
    assert 0 < dark - 400 * MILLI <= (40 + EDGE + 1) / speed * 1e9
    assert [channels for channels, _ in real.lights] == [1, 0]


def test_without_an_encoder_a_stall_is_not_seen(both: Both) -> None:
    def scenario(emulated: Any) -> None:
        _moving(emulated, encoder=0)
        emulated.clock.sleep_until(400 * MILLI)
        emulated.machine.stall(emulated.clock.now())
        seen = emulated.status(900)
        assert seen.light == 1 and seen.measured is None and seen.marks is None

    both(scenario)


def test_a_mark_that_does_not_come_puts_the_light_out(both: Both) -> None:
    def scenario(emulated: Any) -> None:
        _moving(emulated, encoder=0, index=30)
        emulated.clock.sleep_until(500 * MILLI)
        assert emulated.status(500).marks == 1
        emulated.machine.stall(emulated.clock.now())
        emulated.ask(900, "lease", 1000)
        assert emulated.status(930).light == 1, "between the marks nothing is seen"
        seen = emulated.status(1300)
        assert (seen.fault, seen.light, seen.astray) == ("index", 0, True)
        emulated.ask(1310, "lease", 1000)
        assert emulated.ask(1320, "arm") == "index"

    both(scenario, 1_000_000)


def test_home_is_the_next_mark(both: Both) -> None:
    def scenario(emulated: Any) -> None:
        assert emulated.ask(100, "home", 7, 2_000_000) == "state"
        emulated.ask(110, "index", 1, ROUND, 20)
        assert emulated.ask(120, "home", 0, 2_000_000) == emulated.ask(130, "home", 7, 0) == "range"
        emulated.ask(140, "home", 7, 2_000_000)
        assert emulated.status(200).homing
        seen = emulated.status(600)
        assert (seen.zero, seen.speed, seen.marks, seen.homing) == (7, 0, 1, False) and 0 < seen.position < 40

    _, real = both(scenario)
    assert ("home", "7") in real.driver.events


def test_what_makes_no_sense_is_refused(both: Both) -> None:
    def scenario(emulated: Any) -> None:
        wrong = [
            (1, 0, 5),
            (1, 8, 15),
            (1, 8, 0),
            (10**6 + 1, 8, 20),
            (1, 10**6 + 1, 20),
            (-1, 8, 15),
            (1, 8, 10**6 + 1),
        ]
        assert {emulated.ask(100 + 10 * i, "encoder", *each) for i, each in enumerate(wrong)} == {"range"}
        assert emulated.ask(200, "index", -1, 8, 20) == emulated.ask(210, "index", 1, 8, 0) == "range"
        assert emulated.ask(220, "encoder", -1, 8, 16) == emulated.ask(230, "encoder", 0, 1, 0) == ()
        with pytest.raises(BadInput, match="two counts of an encoder"):
            emulated.driver.feedback(Encoder(counts=1, tolerance=1))
        with pytest.raises(BadInput, match="ratios of whole numbers"):
            emulated.driver.feedback(index=Index(distance=12_345_678, tolerance=1))
        emulated.clock.sleep_until(400 * MILLI)
        emulated.driver.feedback(Encoder(counts=0.125, tolerance=40), Index(ROUND, 20))
        seen = emulated.status(500)
        assert seen.measured == 0 and seen.marks == 0

    both(scenario)


def test_thirty_random_stalls_are_dark_in_time_and_light_nothing_twice(new_board: Any, conversation_with: Any) -> None:
    """Rows by steps, each lit once; from the stall on the shaft gets no light beyond the limit's time."""
    from vamgpu.hosts.emulators.controller import EmulatedController

    rng = np.random.default_rng(15)
    for trial in range(30):
        at, speed = float(rng.uniform(300, 800)), int(rng.integers(500, 5000))
        ended = []
        for machine in (EmulatedController(), new_board()) if trial % 5 == 0 else (EmulatedController(),):
            talk = conversation_with(machine)
            if isinstance(machine, EmulatedController):
                machine.on_light = lambda channels, now, talk=talk: talk.lights.append((channels, now))
            talk.ask(90, "encoder", 1, EDGE, 24)
            talk.ask(100, "mode", "steps")
            for i in range(20):
                talk.driver.ask("row", i, 40 + 100 * i, "-", 0, 2000, 1)
            talk.driver.ask("lease", 1000)
            talk.driver.ask("arm")
            talk.driver.ask("go", 5)
            talk.driver.ask("move", 1000 * speed)
            talk.clock.sleep_until(round(at * MILLI))
            machine.stall(talk.clock.now())
            before = talk.driver.status().shown
            talk.clock.sleep(300 * MILLI)
            seen = talk.driver.status()
            lights = talk.lights if isinstance(machine, EmulatedController) else machine.lights
            late = [
                on for channels, on in lights if channels and on > at * MILLI + (24 + EDGE + 2) / speed * 1e9 + MILLI
            ]
            assert seen.light == 0 and not late, (trial, at, speed)
            assert seen.state in ("fault", "done") and (seen.fault == "stall" or seen.shown == 20)
            assert seen.shown <= before + 1, "at most the row within the limit"
            ended.append(seen.shown)
        assert max(ended) - min(ended) <= 1

"""The virtual clock, tracks over time, and the emulated stage."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vamgpu.hosts.emulators.clock import VirtualClock
from vamgpu.hosts.emulators.stage import EmulatedStage
from vamgpu.hosts.emulators.track import Track

MILLI, SECOND = 1_000_000, 1_000_000_000


def test_the_clock_runs_machines_in_order_of_time() -> None:
    class Machine:
        def __init__(self, times: list[int]) -> None:
            self.times, self.acted = times, []

        def due(self) -> int | None:
            return self.times[0] if self.times else None

        def advance(self, now: int) -> None:
            while self.times and self.times[0] <= now:
                order.append((self.times.pop(0), clock.now()))

    order: list[tuple[int, int]] = []
    clock = VirtualClock()
    clock.attach(Machine([5, 20, 30]))
    clock.attach(Machine([1, 20, 25]))
    clock.sleep_until(26)
    assert order == [(1, 1), (5, 5), (20, 20), (20, 20), (25, 25)] and clock.now() == 26
    clock.sleep_until(3)
    assert clock.now() == 26
    clock.sleep(4)
    assert order[-1] == (30, 30)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.integers(1, 3000), st.floats(-500, 500)), min_size=1, max_size=6))
def test_tracks_do_not_jump_and_keep_to_their_acceleration(changes: list[tuple[int, float]]) -> None:
    track, now = Track(acceleration=800.0), 0
    for wait_ms, velocity in changes:
        now += wait_ms * MILLI
        track.run(now, velocity)
    times = np.linspace(0, now + 2 * SECOND, 4001).astype(np.int64)
    x = np.array([track.position(int(t)) for t in times])
    v = np.array([track.velocity(int(t)) for t in times])
    step = np.diff(times) * 1e-9
    assert (np.abs(np.diff(v)) <= 800.0 * step + 1e-6).all()
    assert np.abs(np.diff(x) - step * (v[1:] + v[:-1]) / 2).max() < 800.0 * step.max() ** 2
    assert v[-1] == changes[-1][1]


@settings(max_examples=60, deadline=None)
@given(st.floats(-1000, 1000), st.floats(1, 500))
def test_moves_end_where_they_should_at_rest(target: float, speed: float) -> None:
    track = Track(acceleration=800.0)
    track.go(0, target, speed)
    end = track.settled_at
    assert track.position(end) == target and track.velocity(end) == 0.0
    times = np.linspace(0, end, 500).astype(np.int64)
    v = [abs(track.velocity(int(t))) for t in times]
    assert max(v) <= speed * (1 + 1e-6) + 1e-6


@settings(max_examples=60, deadline=None)
@given(st.floats(1, 5000), st.floats(1, 900))
def test_the_time_a_target_is_reached_is_the_first(target: float, speed: float) -> None:
    track = Track(acceleration=800.0)
    track.run(MILLI, speed)
    at = track.reaches(target, 0)
    assert at is not None
    assert track.position(at) >= target - 1e-5 * speed and track.position(at - 1000) < target


@pytest.mark.slow
@settings(max_examples=100, deadline=None)
@given(st.floats(-200, 400), st.floats(-900, 900), st.floats(1, 400), st.integers(1, 900), st.integers(0, 2))
def test_an_axis_that_is_called_elsewhere_still_reaches_its_targets(
    position: float, speed: float, target: float, at_ms: int, kind: int
) -> None:
    track = Track(acceleration=800.0)
    if kind:
        track.run(MILLI, speed)
    if kind == 2:
        track.go(500 * MILLI, 2 * target, 300.0)
    before = [track.velocity(t * MILLI) for t in range(at_ms, 9000, 50)]
    track.set_position(at_ms * MILLI, position)
    after = [track.velocity(t * MILLI) for t in range(at_ms, 9000, 50)]
    assert after == pytest.approx(before, abs=1e-6), "its motion stays"
    times = np.arange(0, 9 * SECOND, MILLI)
    there = np.array([track.position(int(t)) for t in times]) >= target
    found = track.reaches(target, 0)
    if there.any():
        assert found is not None and times[there.argmax()] - MILLI <= found <= times[there.argmax()]
        assert track.position(found) >= target - 1e-5 * max(abs(speed), 300.0)


def test_a_jump_over_a_target_reaches_it_at_rest() -> None:
    track = Track(acceleration=800.0)
    track.set_position(SECOND, 100.0)
    assert track.reaches(50.0, 0) == SECOND
    assert track.reaches(150.0, 0) is None
    track.set_position(2 * SECOND, 0.0)
    assert track.reaches(50.0, 3 * SECOND) is None


def test_the_stage_moves_as_it_says() -> None:
    stage = EmulatedStage(limit=100_000, acceleration=100_000.0)
    stage.receive(b"/1 1 set maxspeed 16384\n/1 1 move abs 20000\n/1 1 move abs 200000\n/1 1 nonsense\n", 0)
    lines = stage.take(MILLI).decode().split("\r\n")
    assert lines[0] == "@01 1 OK IDLE WR 0" and lines[1] == "@01 1 OK BUSY WR 0"
    assert lines[2].endswith("BADDATA") and lines[3].endswith("BADCOMMAND")
    assert stage.true_position(SECOND) == pytest.approx(10_000 * 1 - 500, rel=1e-3)
    stage.receive(b"/1 1 get pos\n", 4 * SECOND)
    assert stage.take(5 * SECOND) == b"@01 1 OK IDLE WR 20000\r\n"
    stage.receive(b"/01 1 05 get pos:00\n", 6 * SECOND)
    assert stage.take(7 * SECOND) == b"", "a wrong check sum is not answered"

"""Between two lines of a print: keys pressed twice, frames missed twice, hosts that die before they begin a leg."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from doubles import MIRRORS, STEPS, Scene, White, late, roll

from vamgpu.errors import BadInput, DeviceLost
from vamgpu.hosts.emulators.clock import VirtualClock
from vamgpu.hosts.frames.lateness import WebLatePolicy
from vamgpu.hosts.player.controller_mirrors import PREROLL, TriggeredPlayer
from vamgpu.hosts.player.motor import Origin
from vamgpu.hosts.player.run import SafetyLimits
from vamgpu.hosts.process.resume import interrupted
from vamgpu.hosts.records.record import read_run
from vamgpu.hosts.records.state import PrintState
from vamgpu.hosts.safety.interlock import InterlockOpen
from vamgpu.hosts.schedules.clock import TimedQuery
from vamgpu.hosts.schedules.limits import MirrorTiming
from vamgpu.hosts.schedules.mirrors import turned, web
from vamgpu.hosts.schedules.schedule import Schedule
from vamgpu.hosts.schedules.timing import SECOND

QUICK = MirrorTiming(pixels=(16, 2), row_bytes=2, frame={8: 1e-3}, dark=1e-3)


def test_keys_pressed_twice_leave_no_motor_running(run: Path) -> None:
    scene = Scene(run, roll())
    wait = scene.player.wait

    def first() -> None:
        if scene.print.next == 5:
            scene.player.poll = second
            raise KeyboardInterrupt
        wait()

    def second() -> Any:
        raise KeyboardInterrupt

    scene.player.wait = first  # type: ignore[method-assign]
    with pytest.raises(KeyboardInterrupt):
        scene.print.run()
    scene.emulated.clock.sleep(5 * SECOND)
    assert (
        scene.emulated.controller.web.velocity(scene.emulated.clock.now()) == 0 and not scene.emulated.controller.light
    )
    assert read_run(run).state is PrintState.CANCELLED


def test_a_key_in_the_halt_leaves_no_motor_running(run: Path) -> None:
    """The second key comes while the controller is told to stop, before the line has left."""
    scene, presses = Scene(run, roll()), [1]
    stop = scene.machines.controller.stop

    def pressed() -> None:
        if presses:
            presses.pop()
            raise KeyboardInterrupt
        stop()

    scene.machines.controller.stop = pressed  # type: ignore[method-assign]
    wait = scene.player.wait

    def first() -> None:
        if scene.print.next == 5:
            raise KeyboardInterrupt
        wait()

    scene.player.wait = first  # type: ignore[method-assign]
    with pytest.raises(KeyboardInterrupt):
        scene.print.run()
    scene.emulated.clock.sleep(5 * SECOND)
    assert not presses and scene.emulated.controller.web.velocity(scene.emulated.clock.now()) == 0
    assert read_run(run).state is PrintState.CANCELLED


@pytest.mark.parametrize("late", [k / 20 for k in range(10)])
def test_a_pause_in_the_last_frame_is_the_end(run: Path, late: float) -> None:
    scene = Scene(run, roll(10))
    with scene.print.guard:
        scene.print.begin(0)
        scene.until(8)
        scene.print.lease.keep(force=True)
        scene.emulated.clock.sleep(round(late * 0.4 * SECOND))
        scene.print.pause()
        for _ in range(60):
            scene.player.wait()
            if not scene.print.step():
                break
    assert scene.print.states.state in (PrintState.COMPLETE, PrintState.PAUSED) and not scene.emulated.controller.light
    assert scene.print.states.state is PrintState.COMPLETE or scene.print.next < 10


# ---- what was shown, and how often ---------------------------------------------------------------------------
def test_what_is_lit_while_a_print_is_judged_enough_is_kept(run: Path) -> None:
    def enough() -> str | None:
        if scene.print.next < 5:
            return None
        scene.emulated.clock.sleep(SECOND // 5)  # some frames more
        return "enough"

    scene = Scene(run, roll(), enough=enough)
    assert scene.print.run() is PrintState.COMPLETE
    shown, lit = read_run(run).shown, scene.seconds()
    assert len(shown) > 6 and (lit > 0).sum() == len(shown) == scene.emulated.controller.shown - PREROLL
    budget = scene.print.guard.budget
    assert budget is not None and budget.spent == pytest.approx(1e-9 * shown["on_time"].sum())


def test_a_frame_missed_twice_is_shown_twice_again(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    late(monkeypatch, {12, 16, 36})
    scene = Scene(run, turned(24, speed=40, engines=MIRRORS, turns=2), depth=2)
    assert scene.print.run() is PrintState.COMPLETE
    shown = read_run(run).shown
    assert shown["slot"][shown["dark"] > 0].tolist() == [12, 16, 36]
    again = shown[(shown["slot"] >= 48) & (shown["on_time"] > 0)]
    assert sorted(again["frame"].tolist()) == [12, 12, 16]
    lit = scene.seconds(turn=24)
    assert np.abs(lit / lit[0] - 1).max() < 2e-3


def test_black_that_was_meant_is_not_repeated(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    late(monkeypatch, {20}, {10, 12, 14})
    scene = Scene(run, turned(24, speed=40, engines=MIRRORS), depth=2)
    assert scene.print.run() is PrintState.COMPLETE
    assert len(scene.player.schedule) == 48
    lit = scene.seconds(turn=24)
    assert np.abs(lit / lit[0] - 1).max() < 2e-3, "what was never missed is not shown again"


def test_a_fast_motion_has_the_time_that_its_ramp_takes(run: Path) -> None:
    """180 000 microsteps/s at 200 000 microsteps/s²: nine tenths of a second."""
    scene = Scene(run, turned(360, speed=180, engines=QUICK))
    assert scene.print.run() is PrintState.COMPLETE


@pytest.mark.parametrize(
    "rested", [pytest.param(rested, marks=() if rested == 30 else pytest.mark.slow) for rested in range(26, 33)]
)
@pytest.mark.parametrize("kind", ["web", "vial"])
def test_black_that_a_pause_comes_before_is_not_repeated(
    run: Path, monkeypatch: pytest.MonkeyPatch, kind: str, rested: int
) -> None:
    """It was on its way to the mirrors; the next leg shows the frame itself."""
    late(monkeypatch, {30})
    scene = Scene(run, turned(240, speed=20, engines=MIRRORS) if kind == "vial" else roll(), depth=2)
    scene.paused(rested)
    scene.print._pausing = False
    ended = scene.print.run()
    lit, shown = scene.seconds(turn=240 if kind == "vial" else None), read_run(run).shown
    came = 30 in shown["slot"][shown["dark"] > 0]
    assert ended is (PrintState.INCOMPLETE if came and kind == "web" else PrintState.COMPLETE)
    assert came is (scene.print.next > 240) or kind == "web"
    assert np.flatnonzero(np.abs(lit / np.median(lit) - 1) > 2e-3).tolist() == ([30] if came and kind == "web" else [])


@pytest.mark.parametrize("moment", ["last frame", "run-up"])
def test_a_pause_before_the_turn_that_is_added_leaves_it_dark(
    run: Path, monkeypatch: pytest.MonkeyPatch, moment: str
) -> None:
    late(monkeypatch, {10})
    scene = Scene(run, turned(24, speed=30, engines=MIRRORS), depth=2)
    wait, prime = scene.player.wait, scene.player.prime

    def waited() -> None:
        if moment == "last frame" and scene.print.next == 23:
            scene.print.pause()
        wait()

    def primed(first: int, alive: Callable[[], None]) -> int:
        ahead = prime(first, alive)
        if moment == "run-up" and first == 24 and scene.print.states.state is PrintState.PRINTING:
            scene.print.pause()
        return ahead

    scene.player.wait, scene.player.prime = waited, primed  # type: ignore[method-assign]
    assert scene.print.run() is PrintState.PAUSED and scene.print.next == 24
    assert not scene.emulated.controller.light
    assert [event["to"] for event in read_run(run).events if event["event"] == "light"] == ["on", "off"]
    assert scene.print.run() is PrintState.COMPLETE
    lit = scene.seconds(turn=24)
    assert np.abs(lit / np.median(lit) - 1).max() < 2e-3


@pytest.mark.parametrize(
    "speed", [30.0, *(pytest.param(speed, marks=pytest.mark.slow) for speed in (33.7, 36.3, 41.1)), 44.4]
)
def test_an_added_turn_has_a_lease_however_soon_it_comes(
    run: Path, monkeypatch: pytest.MonkeyPatch, speed: float
) -> None:
    late(monkeypatch, {10})
    assert Scene(run, turned(24, speed=speed, engines=MIRRORS), depth=2).print.run() is PrintState.COMPLETE


def test_what_another_program_plays_meanwhile_ends_the_print(run: Path) -> None:
    scene = Scene(run, roll())
    scene.paused()
    scene.machines.controller.go(7)
    scene.machines.controller.stop()
    with pytest.raises(DeviceLost, match="served another program"):
        scene.print.run()


def test_slow_vials_have_the_time_that_they_have(run: Path) -> None:
    assert Scene(run, turned(8, speed=20, engines=MIRRORS)).print.run() is PrintState.COMPLETE


# ---- rests ---------------------------------------------------------------------------------------------------
def test_a_pause_counts_until_there_is_light_again(run: Path) -> None:
    scene = Scene(run, roll())
    scene.paused()
    scene.emulated.clock.sleep(29 * SECOND)  # and the run-up, for longer than the last second
    before = len(scene.emulated.controller.intervals)
    with pytest.raises(BadInput, match="decayed"):
        scene.print.run()
    assert len(scene.emulated.controller.intervals) == before and not scene.emulated.controller.light


def test_a_pause_counts_what_a_vial_still_turns(run: Path) -> None:
    """At 10 deg/s the next pose comes round after up to 36 s."""
    scene = Scene(run, turned(60, speed=10, engines=MIRRORS), limits=SafetyLimits(resume=20 * SECOND))
    scene.paused()
    scene.emulated.clock.sleep(SECOND)
    before = len(scene.emulated.controller.intervals)
    with pytest.raises(BadInput, match="decayed"):
        scene.print.run()
    assert len(scene.emulated.controller.intervals) == before and not scene.emulated.controller.light


@pytest.mark.parametrize("speed", [6, 40, 41.7, 90])
def test_a_vial_begins_within_a_run_up(run: Path, speed: float) -> None:
    """And not a turn later, for a rounding of half a microstep."""
    scene = Scene(run, turned(120, speed=speed, engines=MIRRORS))
    with scene.print.guard:
        began = scene.emulated.clock.now()
        scene.print.begin(0)
        scene.until(1)
        passed = (scene.emulated.clock.now() - began) / SECOND
    assert passed < 4.0 + 6.0 * 3.0 / speed, "seconds from rest to the first frame"


def test_a_controller_that_was_reset_in_a_pause_is_told(run: Path) -> None:
    scene = Scene(run, roll())
    scene.paused()
    scene.emulated.controller.lose_power(scene.emulated.clock.now())
    with pytest.raises(DeviceLost, match="another zero or play than this print: it lost its power"):
        scene.print.run()
    assert not scene.emulated.controller.light


def test_a_controller_that_is_reset_on_the_way_to_the_light_is_told(run: Path) -> None:
    scene = Scene(run, roll())
    scene.paused()
    lit, fill = len(scene.emulated.controller.intervals), scene.player._fill

    def meanwhile(first: int, alive: Callable[[], None]) -> None:
        fill(first, alive)
        scene.emulated.controller.lose_power(scene.emulated.clock.now())

    scene.player._fill = meanwhile  # type: ignore[method-assign]
    with pytest.raises(DeviceLost, match="another zero or play than this print: it lost its power"):
        scene.print.run()
    assert len(scene.emulated.controller.intervals) == lit


def test_a_controller_with_another_zero_is_told_in_the_light(run: Path) -> None:
    scene = Scene(run, roll())
    with pytest.raises(InterlockOpen, match="another zero or play than this print"), scene.print.guard:
        scene.print.begin(0)
        scene.until(3)
        scene.emulated.controller.zero = 0
        scene.until(5)
    assert not scene.emulated.controller.light


@pytest.mark.parametrize("begun", [False, True])
def test_another_host_knows_whether_a_segment_had_begun(run: Path, begun: bool) -> None:
    """A host pauses, goes on, and dies right before, or after, it lets the rows play."""
    scene = Scene(run, roll(120))
    scene.paused(20)
    rested = scene.print.next
    scene.print._pausing = False
    scene.print.guard.__enter__()
    if begun:
        scene.print.begin(rested)
        scene.until(rested + 3)
    else:
        scene.player.start = lambda: None  # type: ignore[method-assign]
        scene.print.begin(rested)
    scene.emulated.clock.sleep(SECOND)
    scene.print.guard._release_process()
    shown = len(np.flatnonzero(scene.seconds()))
    assert (shown > rested) is begun
    scene.emulated.alps[0].disconnect()
    machines = scene.emulated.machines(STEPS / 0.0785)
    found = interrupted(run, machines.controller, roll(120))
    assert found.unseen >= rested and found.first >= shown and (found.first == rested) is not begun


def test_a_clock_that_was_set_back_is_told(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene(run, roll())
    scene.paused()
    now = time.time()
    monkeypatch.setattr("vamgpu.hosts.process.resume.time", SimpleNamespace(time=lambda: now - 3600))
    with pytest.raises(BadInput, match="ahead of this host's clock"):
        interrupted(run, scene.machines.controller, roll())


# ---- answers -------------------------------------------------------------------------------------------------
def test_a_host_that_was_held_up_asks_again() -> None:
    clock, took = VirtualClock(), iter([2, 2, 40, 2])

    def ask() -> int:
        clock.sleep(next(took) * 1_000_000)
        return clock.now()

    asking = TimedQuery(clock, ask, slack=0.0)
    for _ in range(3):
        at, answer = asking()
        assert answer - at == 1_000_000, "in the middle of a short exchange"
    assert next(took, None) is None


def test_two_projectors_are_let_go_though_one_fails(run: Path) -> None:
    scene = Scene(run, replace_engines(roll()))
    with scene.print.guard:
        scene.print.begin(0)
        queues = scene.player._queues
        closed: list[int] = []
        for number, each in enumerate(queues):
            each.close = fails(closed, number)
        with pytest.raises(DeviceLost):
            scene.player.halt()
    assert sorted(closed) == [0, 1]


def fails(closed: list[int], number: int) -> Callable[[], None]:
    def close() -> None:
        closed.append(number)
        raise DeviceLost("gone")

    return close


def replace_engines(schedule: Schedule) -> Schedule:
    return web(len(schedule), advance=0.0785, speed=0.8, engines=(MIRRORS, replace(MIRRORS)))


# ---- arguments -----------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("name", "value"),
    [("tolerance", "0.5"), ("tolerance", np.inf), ("budget", np.inf), ("resume", np.nan), ("resume", np.inf),
     ("lease", np.inf), ("lease", None)],
)  # fmt: skip
def test_limits_that_limit_nothing_are_refused(name: str, value: Any) -> None:
    with pytest.raises(BadInput, match=name):
        SafetyLimits(**{name: value})


def test_what_is_no_number_is_told(run: Path, tmp_path: Path) -> None:
    odd: Any = "1"
    for number, power in enumerate((odd, None, 0.0, 1.5, np.nan)):
        with pytest.raises(BadInput, match="power"):
            Scene(tmp_path / str(number), roll(), power=power)
    scene = Scene(run, roll())
    slots: list[Any] = [odd, 1.5, True, -1, 60]
    for first in slots:
        with pytest.raises(BadInput, match="slot"):
            scene.print.run(first)
    with scene.print.guard as guard, pytest.raises(BadInput, match="power"):
        guard.observe(armed=True, motion=0.0, shown=0, scheduled=0)
        guard.on(odd)
    assert not scene.emulated.controller.light
    wrong: list[dict[str, Any]] = [{"depth": 0}, {"depth": odd}, {"sequences": odd}, {"sequences": 1}]
    for options in wrong:
        with pytest.raises(BadInput, match=next(iter(options))):
            TriggeredPlayer(roll(), scene.machines, [White()], **options)
    for at, zero in ((np.nan, 1), (odd, 1), (0.0, 0), (0.0, 1.5)):
        with pytest.raises(BadInput, match="origin|zero"):
            Origin(at, zero)  # type: ignore[arg-type]
    wrong = [{"allowed": np.inf}, {"allowed": -1}, {"allowed": None}, {"window": 0}]
    for options in wrong:
        with pytest.raises(BadInput):
            WebLatePolicy(**options)

"""Prints that something made dark, and that go on: nothing is lit twice, and nothing is missing that is not told."""

from __future__ import annotations

import gc
import random
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from doubles import MIRRORS, Scene, late, roll
from test_video import Room

from vamgpu.errors import DeviceError, OriginLost, VamError
from vamgpu.hosts.emulators.clock import VirtualClock
from vamgpu.hosts.player.operator import attended
from vamgpu.hosts.player.run import SafetyLimits
from vamgpu.hosts.records.account import LightAccount, account, wanted_light
from vamgpu.hosts.records.record import read_run
from vamgpu.hosts.records.state import PrintState
from vamgpu.hosts.safety.interlock import InterlockOpen
from vamgpu.hosts.schedules.mirrors import turned
from vamgpu.hosts.schedules.schedule import Schedule
from vamgpu.hosts.schedules.timing import SECOND

SLOTS = 24


def vial(turns: int = 1) -> Schedule:
    return turned(SLOTS, speed=60, engines=MIRRORS, turns=turns)


PRINTS: dict[str, Callable[[], Schedule]] = {"vial": vial, "web": lambda: roll(SLOTS), "turns": lambda: vial(2)}


def at(scene: Scene, slots: list[int], happens: Callable[[], object]) -> None:
    """Something happens when slots were seen, once each."""
    wait, left = scene.player.wait, sorted(slots)

    def waited() -> None:
        if left and scene.print.next >= left[0]:
            left.pop(0)
            happens()
        wait()

    scene.player.wait = waited  # type: ignore[method-assign]


def judged(scene: Scene) -> LightAccount:
    """The account of a print's light, which is true of what the resin saw."""
    turn = SLOTS if scene.schedule.unit == "deg" else None
    lit = scene.seconds(turn=turn)[:SLOTS] * 1e9
    found = account(scene.read(), wanted_light(scene.schedule))
    assert found is not None
    slack = 0.004 * found.wanted[0]
    assert (lit <= found.wanted[0] + slack).all(), "nothing is lit twice"
    assert (found.sure[0] - slack <= lit).all() and (lit <= found.sure[0] + found.unsure[0] + slack).all()
    return found


def sleep(scene: Scene, seconds: float) -> None:
    scene.emulated.clock.sleep(round(seconds * SECOND))


def open_door(scene: Scene) -> None:
    scene.emulated.controller.open_interlock(scene.emulated.clock.now())


def close_door(scene: Scene) -> None:
    scene.emulated.controller.interlock_closed = True


def fill_disk(scene: Scene) -> None:
    def full(*_: object) -> int:
        raise OSError(28, "No space left on device")

    scene.print.folder._write, scene.free = full, scene.print.folder._write  # type: ignore[attr-defined]


def free_disk(scene: Scene) -> None:
    scene.print.folder._write = scene.free  # type: ignore[attr-defined]


def fail(scene: Scene) -> None:
    raise DeviceError("the device that makes frames is gone")


FAULTS: dict[str, tuple[Callable[[Scene], object], Callable[[Scene], object]]] = {
    "lease": (lambda scene: sleep(scene, 0.4), lambda scene: None),
    "door": (open_door, close_door),
    "line": (lambda scene: scene.emulated.port.unplug(), lambda scene: scene.emulated.port.replug()),
    "disk": (fill_disk, free_disk),
    "frames": (fail, lambda scene: None),
}


@pytest.mark.parametrize("kind", PRINTS)
@pytest.mark.parametrize("fault", FAULTS)
def test_what_passes_holds_a_print_and_it_goes_on(run: Path, kind: str, fault: str) -> None:
    scene = Scene(run, PRINTS[kind]())
    breaks, repairs = FAULTS[fault]
    at(scene, [7], lambda: breaks(scene))
    with pytest.raises(VamError):
        scene.print.run()
    assert scene.print.states.state is PrintState.HELD and "slots remain" in scene.print.states.message
    sleep(scene, 1.0)
    motion = scene.emulated.controller.web.velocity(scene.emulated.clock.now())
    assert not scene.emulated.controller.light and (motion == 0 or fault == "line")
    repairs(scene)
    assert scene.print.run() is PrintState.INCOMPLETE
    found = judged(scene)
    assert 1 <= found.facts()["short"] <= (4 if fault == "line" else 1)
    assert f"of {SLOTS} frames" in scene.read().message


def test_a_door_that_is_still_open_holds_it_again(run: Path) -> None:
    scene = Scene(run, vial())
    at(scene, [7], lambda: open_door(scene))
    for _ in range(3):
        with pytest.raises(VamError, match="interlock"):
            scene.print.run()
        assert scene.print.states.state is PrintState.HELD
    close_door(scene)
    assert scene.print.run() is PrintState.INCOMPLETE and judged(scene).facts()["short"] == 1


def test_resin_that_waited_too_long_ends_a_held_print(run: Path) -> None:
    scene = Scene(run, vial())
    at(scene, [7], lambda: open_door(scene))
    with pytest.raises(InterlockOpen):
        scene.print.run()
    sleep(scene, 31)
    close_door(scene)
    with pytest.raises(VamError, match="decayed"):
        scene.print.run()
    assert scene.read().state is PrintState.ERROR


def test_a_controller_that_forgot_ends_the_print(run: Path) -> None:
    scene = Scene(run, vial())
    at(scene, [7], lambda: scene.emulated.controller.lose_power(scene.emulated.clock.now()))
    with pytest.raises(InterlockOpen, match="another zero or play"):
        scene.print.run()
    assert scene.read().state is PrintState.ERROR
    other = Scene(run.with_name("other"), vial())
    at(other, [7], lambda: open_door(other))
    with pytest.raises(InterlockOpen):
        other.print.run()
    close_door(other)
    other.emulated.controller.lose_power(other.emulated.clock.now())
    with pytest.raises(OriginLost):
        other.print.run()
    assert other.read().state is PrintState.ERROR


def test_wrong_light_ends_the_print(run: Path) -> None:
    scene = Scene(run, vial())
    at(scene, [7], lambda: setattr(scene.emulated, "lose_triggers", 1))
    with pytest.raises(InterlockOpen, match="is shown; expected"):
        scene.print.run()
    assert scene.read().state is PrintState.ERROR


def test_nobody_goes_on_for_more_than_was_allowed(run: Path) -> None:
    scene = Scene(run, vial())
    at(scene, [5, 10, 15], lambda: sleep(scene, 0.4))
    with pytest.raises(InterlockOpen, match="lease"):
        attended(scene.print, unattended=2)
    assert scene.print.states.state is PrintState.HELD and scene.print.next >= 15


def test_somebody_is_asked_first(run: Path) -> None:
    scene, asked = Scene(run, vial()), []
    at(scene, [5], lambda: sleep(scene, 0.4))
    assert attended(scene.print, go_on=lambda: not asked.append(scene.emulated.controller.light)) is not None
    assert asked == [0] and scene.read().state is PrintState.INCOMPLETE


def test_black_is_owed_over_a_hold(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A frame that was late before the hold is shown in an added turn; the one that was cut is told."""
    late(monkeypatch, {10})
    scene = Scene(run, vial(), depth=2)
    at(scene, [16], lambda: open_door(scene))
    with pytest.raises(InterlockOpen):
        scene.print.run()
    close_door(scene)
    assert scene.print.run() is PrintState.INCOMPLETE
    found = judged(scene)
    assert found.facts()["short"] == 1 and not found.short[0, 10]


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("kind", PRINTS)
def test_random_stalls_lose_no_print(run: Path, kind: str, seed: int) -> None:
    scene, chance = Scene(run, PRINTS[kind]()), random.Random(seed)
    stalls = [chance.uniform(0.02, 1.0) for _ in range(3)]
    at(scene, chance.sample(range(1, len(scene.schedule) - 1), 3), lambda: sleep(scene, stalls.pop()))
    state = attended(scene.print, unattended=3)
    assert (state is PrintState.COMPLETE) is judged(scene).complete and state.ended


def test_a_host_that_is_slow_changes_nothing_on_a_clock_of_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Real time, threads and garbage are no part of these prints: what fails once fails each time."""
    kept, delays = [], random.Random(3)
    wait = VirtualClock.sleep_until

    def late(clock: VirtualClock, until: int) -> None:
        if delays.random() < 0.01:
            time.sleep(delays.uniform(0.0, 0.01))
            gc.collect(0)
        wait(clock, until)

    for name in ("quick", "slow"):
        test_random_stalls_lose_no_print(tmp_path / name, "turns", 27)
        found = read_run(tmp_path / name)
        told = [{key: value for key, value in event.items() if key != "wall"} for event in found.events]
        kept.append((found.shown.tolist(), told, found.message))
        monkeypatch.setattr(VirtualClock, "sleep_until", late)
    assert kept[0] == kept[1]


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(1, 6))])
def test_random_stalls_and_doors_lose_no_print_on_a_video_cable(tmp_path: Path, seed: int) -> None:
    room, chance = Room(tmp_path / "run", turns=1, added=3), random.Random(seed)
    room.print.limits = SafetyLimits(budget=2.0)
    assert room.print.guard.budget is not None
    room.print.guard.budget.limit *= 2

    def door() -> None:
        room.emulated.controller.open_interlock(room.emulated.clock.now())
        room.emulated.controller.interlock_closed = True

    stall = lambda: room.emulated.clock.sleep(round(chance.uniform(0.02, 1.0) * SECOND))  # noqa: E731
    room.frames.happens = {chance.randrange(30, 1000): chance.choice((door, stall)) for _ in range(3)}
    try:
        state = attended(room.print, unattended=3)
    finally:
        room.folder.close()
    found = account(room.told, wanted_light(room.schedule))
    assert found is not None and state.ended and (state is PrintState.COMPLETE) is found.complete
    placed = zip(room.seen, room.astray(), strict=True)
    own = np.bincount([frame for (frame, _), off in placed if off == 0], minlength=360)
    assert (own <= 3 + 1).all(), "at its own angle no frame is shown twice"
    short = np.flatnonzero(room.slots() < 3)  # a frame that came late is told by how late it was
    assert set(short.tolist()) <= set(np.flatnonzero(found.short[0]).tolist()), "what is missing is told"

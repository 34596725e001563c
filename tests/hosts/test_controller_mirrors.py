"""Prints on triggered mirrors, on an emulated rig: what is shown, what is late, and in which order it goes dark."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from math import pi
from pathlib import Path

import numpy as np
import pytest

from vamgpu.errors import BadInput, DeviceError, Underrun
from vamgpu.hosts.emulators.array import ArrayModel
from vamgpu.hosts.emulators.rigs import EmulatedMirrorRig
from vamgpu.hosts.frames.upload import UploadQueue
from vamgpu.hosts.player import mirrors
from vamgpu.hosts.player.controller_mirrors import PREROLL, TriggeredPlayer
from vamgpu.hosts.player.run import Print
from vamgpu.hosts.process.resume import interrupted
from vamgpu.hosts.records.record import RunFolder, RunRecord, read_run
from vamgpu.hosts.records.state import PrintState
from vamgpu.hosts.safety.interlock import InterlockOpen
from vamgpu.hosts.schedules.limits import LensTiming, MirrorTiming
from vamgpu.hosts.schedules.mirrors import turned, web
from vamgpu.hosts.schedules.schedule import Schedule
from vamgpu.hosts.schedules.timing import SECOND

MODEL = ArrayModel(height=2, width=16)
MIRRORS = MirrorTiming(pixels=(16, 2), row_bytes=2, dark=2e-3)
POSE = 9.0 * pi / 360
POWERS = (0.0, 0.7, 1.4)
STEPS = 1000


class White:
    """Frames that are full on. act: called with the numbers of frames that are made."""

    bits = 8

    def __init__(self, act: Callable[[np.ndarray], None] = lambda numbers: None) -> None:
        self.act = act

    def planes(self, numbers: np.ndarray) -> np.ndarray:
        self.act(numbers)
        return np.full((len(numbers), 8, 2, 2), 255, np.uint8)

    def frame(self, number: int) -> np.ndarray:
        return np.full((2, 16), 255, np.uint8)


@dataclass
class Stand:
    """A print on an emulated rig."""

    emulated: EmulatedMirrorRig
    player: TriggeredPlayer
    print: Print
    path: Path

    def run(self) -> RunRecord:
        """Print to the end."""
        assert self.print.run() in (PrintState.COMPLETE, PrintState.INCOMPLETE)
        return self.read()

    def read(self) -> RunRecord:
        self.print.folder.close()
        return read_run(self.path)

    def steps(self, until: Callable[[], bool]) -> None:
        """Look, as `Print.run` does, until something is so."""
        while not until():
            self.player.wait()
            assert self.print.step()

    def seconds(self, poses: int, turn: int | None = None) -> np.ndarray:
        """How long light fell, by pose: the mirrors are white."""
        return self.emulated.recorder.seconds(0, poses, turn)[:, :, 0, 0].sum(axis=0)


def stand(path: Path, schedule: Schedule, frames: White | None = None, depth: int | None = None) -> Stand:
    emulated = EmulatedMirrorRig(STEPS, MODEL, powers=POWERS if schedule.plane.any() else ())
    player = TriggeredPlayer(
        schedule, emulated.machines(STEPS / float(schedule.advance)), [frames or White()], depth=depth
    )
    return Stand(emulated, player, Print(player, RunFolder.begin(path, {}, "")), path)


def roll(poses: int) -> Schedule:
    return web(poses, advance=POSE, speed=2.0, engines=MIRRORS)


def spun(turns: int = 1) -> Schedule:
    return turned(40, speed=40, engines=MIRRORS, turns=turns)


@pytest.fixture
def run(tmp_path: Path) -> Path:
    return tmp_path / "run"


@pytest.mark.slow
def test_ten_minutes_of_web_at_48_mm_a_minute_lose_nothing(run: Path) -> None:
    poses = int(600 * 0.8 / POSE)
    schedule = web(poses, advance=POSE, speed=0.8, engines=MIRRORS, lens=LensTiming(settle=6e-3), focus=POWERS)
    at = stand(run, schedule)
    shown = at.run().shown
    assert schedule.duration > 599 * SECOND and len(shown) == len(schedule) > 18_000
    assert not shown["dark"].any() and shown["late"].max() < 0 and at.emulated.recorder.astray == 0.0
    lit = at.seconds(poses)
    assert np.abs(lit / (3e-9 * schedule.on[0]) - 1).max() < 1e-4, "every pose got its three frames"


@pytest.mark.slow
def test_turns_of_a_vial_at_40_degrees_a_second_lose_nothing(run: Path) -> None:
    schedule = turned(360, speed=40, engines=MIRRORS, turns=20)
    at = stand(run, schedule)
    shown = at.run().shown
    assert len(shown) == 20 * 360
    assert not shown["dark"].any() and shown["late"].max() < 0
    lit = at.seconds(360, turn=360)
    assert np.abs(lit / (20e-9 * schedule.on[0]) - 1).max() < 1e-3


# ---- frames that are late ---------------------------------------------------------------------------------
def hide(monkeypatch: pytest.MonkeyPatch, slots: set[int], end: int = 10_000) -> None:
    """Frames of some slots are not made before black stands for them, nor any from ``end`` on; those added are."""

    class Torn(UploadQueue):
        def make(self, timeout: float = 0.0) -> bool:
            late = self.made - PREROLL in slots and self.uploaded <= self.made
            if self.made - PREROLL >= end or (late and len(self) > 42):
                return False
            return super().make(timeout)

    monkeypatch.setattr(mirrors, "UploadQueue", Torn)


def test_two_lost_poses_are_black_and_the_others_keep_their_place(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    hide(monkeypatch, {100, 300, 700})
    at = stand(run, roll(800), depth=2)
    run_, shown = at.run(), read_run(run).shown
    assert run_.state is PrintState.INCOMPLETE and "3 of 800 frames are underexposed" in run_.message
    assert shown["slot"][shown["dark"] > 0].tolist() == [100, 300, 700] and at.print.board.now.dark == 3
    assert np.flatnonzero(at.seconds(800) == 0).tolist() == [100, 300, 700]


def test_the_third_in_a_turn_puts_the_light_out_and_then_stops_the_web(
    run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    hide(monkeypatch, {100, 300, 458})
    at = stand(run, roll(800), depth=2)
    web, moving = at.emulated.controller.web, []
    light = at.emulated.controller.on_light
    assert light is not None

    def watched(channels: int, now: int) -> None:
        light(channels, now)
        moving.append((channels, web.velocity(now)))

    at.emulated.controller.on_light = watched
    with pytest.raises(Underrun, match="more than 2 of 360 angles were lost, the last at angle 458"):
        at.print.run()
    assert moving[-1][0] == 0 and moving[-1][1] > 0, "dark while the web still moves"
    assert web.velocity(at.emulated.clock.now() + SECOND) == 0
    lit = at.seconds(800)
    assert lit[:100].all() and not lit[458:].any() and at.read().state is PrintState.HELD


def test_a_vial_shows_what_it_missed_in_a_turn_that_is_added(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    hide(monkeypatch, {10, 52})
    at = stand(run, spun(turns=2), depth=2)
    shown = at.run().shown
    assert shown["frame"][shown["dark"] > 0].tolist() == [10, 12]
    again = shown[shown["slot"] >= 80]
    assert again["frame"][again["frame"] >= 0].tolist() == [10, 12] and again["slot"].tolist() == [*range(80, 120)]
    lit = at.seconds(40, turn=40)
    assert np.abs(lit / lit[0] - 1).max() < 1e-3, "every angle got the same light"
    assert at.emulated.controller.web.velocity(at.emulated.clock.now()) >= 0


def test_a_vial_whose_frames_stay_out_ends_dark(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    hide(monkeypatch, set(), end=10)
    at = stand(run, spun(turns=2), depth=2)
    with pytest.raises(Underrun, match="a whole turn of 40"):
        at.print.run()
    assert not at.emulated.controller.light and np.flatnonzero(at.seconds(80)).max() == 9


def test_a_source_that_fails_puts_the_light_out(run: Path) -> None:
    def gone(numbers: np.ndarray) -> None:
        if 200 in numbers:
            raise DeviceError("the device that makes frames is gone")

    at = stand(run, roll(400), White(gone))
    with pytest.raises(DeviceError, match="is gone"):
        at.print.run()
    assert not at.emulated.controller.light and at.read().state is PrintState.HELD


def test_a_source_that_stalls_too_long_lets_the_lease_run_out(run: Path) -> None:
    """In one thread a stalled source holds up the host: the controller alone makes it dark."""
    at = stand(run, roll(400), White(lambda numbers: at.emulated.clock.sleep(SECOND if 200 in numbers else 0)))
    with pytest.raises(InterlockOpen, match="lease"):
        at.print.run()
    times, channels = np.array(at.emulated.recorder._times), np.array(at.emulated.recorder._channels)
    dark, last = times[channels == 0].max(), times[channels > 0].max()
    assert 0 < dark - last <= at.print.limits.lease


# ---- triggers and motion ------------------------------------------------------------------------------------
def test_mirrors_that_count_wrongly_before_the_print_get_no_light(run: Path) -> None:
    at = stand(run, roll(100))
    at.emulated.lose_triggers = 1
    with pytest.raises(InterlockOpen, match="frame 0 is shown; expected frame 1"):
        at.print.run()
    assert not at.emulated.recorder.light and at.read().shown.size == 0


def test_a_trigger_that_the_mirrors_missed_ends_the_print_within_a_poll(run: Path) -> None:
    at = stand(run, roll(200))
    with at.print.guard:
        at.print.begin(0)
        at.steps(lambda: at.print.next >= 50)
        at.emulated.lose_triggers = 1
        with pytest.raises(InterlockOpen, match="is shown; expected"):
            at.steps(lambda: False)
        assert not at.emulated.controller.light
    assert np.flatnonzero(at.seconds(200)).max() <= 52


def test_triggers_that_stop_put_the_light_out(run: Path) -> None:
    at = stand(run, roll(200))
    with at.print.guard:
        at.print.begin(0)
        at.steps(lambda: at.print.next >= 50)
        at.emulated.controller._row_due = lambda: None  # type: ignore[method-assign]
        since = at.emulated.clock.now()
        with pytest.raises(InterlockOpen, match="no trigger for .* ms after frame"):
            at.steps(lambda: False)
        assert at.emulated.clock.now() - since < 3 * SECOND // 8 and not at.emulated.controller.armed


def test_rows_that_come_too_late_end_the_print(run: Path) -> None:
    at = stand(run, roll(400))
    with at.print.guard:
        at.print.begin(0)
        at.player._send = lambda free: at.player.__class__._send(at.player, 0)  # type: ignore[method-assign]
        with pytest.raises(InterlockOpen):
            at.steps(lambda: False)
        assert not at.emulated.controller.light


def test_an_interrupt_is_dark_first_and_cancels(run: Path) -> None:
    def act(numbers: np.ndarray) -> None:
        if 200 in numbers:
            raise KeyboardInterrupt

    at = stand(run, roll(400), White(act))
    with pytest.raises(KeyboardInterrupt):
        at.print.run()
    assert not at.emulated.controller.light and at.read().state is PrintState.CANCELLED


# ---- rests --------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("schedule", [roll(120), spun()], ids=["web", "vial"])
@pytest.mark.parametrize("after", [0.0, 0.4, 1.013])
def test_a_pause_cuts_no_frame(run: Path, schedule: Schedule, after: float) -> None:
    at = stand(run, schedule)
    poses, unit = len(schedule), schedule.unit
    with at.print.guard:
        at.print.begin(0)
        at.steps(lambda: at.print.next >= 3)
        at.print.lease.keep(force=True)  # a fifth of a second without a look is more than any lease is sure to bear
        at.emulated.clock.sleep(round(after * 0.2 * SECOND))
        at.print.pause()
        while at.print.step():
            at.player.wait()
    assert at.print.states.state is PrintState.PAUSED and not at.emulated.controller.light
    at.emulated.clock.sleep(5 * SECOND)
    assert at.emulated.controller.web.velocity(at.emulated.clock.now()) == 0
    shown = at.run().shown
    assert shown["slot"].tolist() == list(range(poses)) and not shown["dark"].any()
    lit = at.seconds(poses, turn=40 if unit == "deg" else None)
    assert np.abs(lit / lit[0] - 1).max() < 1e-3, "every pose got all its light, once"


def test_a_pause_that_is_too_long_is_the_end(run: Path) -> None:
    at = stand(run, roll(120))
    with at.print.guard:
        at.print.begin(0)
        at.steps(lambda: at.print.next >= 3)
        at.print.pause()
        while at.print.step():
            at.player.wait()
    at.emulated.clock.sleep(31 * SECOND)
    with pytest.raises(BadInput, match="decayed"):
        at.print.run()


# ---- a host that died ---------------------------------------------------------------------------------------
def died(run: Path, schedule: Schedule) -> Stand:
    """A print whose host is gone in the midst: nobody leaves the guard, and the folder stays as it is."""
    at = stand(run, schedule)
    at.print.guard.__enter__()
    at.print.begin(0)
    at.steps(lambda: at.print.next >= 12)
    at.print.guard._release_process()
    at.emulated.clock.sleep(SECOND)
    assert not at.emulated.controller.light, "the lease has run out"
    at.emulated.alps[0].disconnect()
    return at


@pytest.mark.parametrize("schedule", [roll(120), spun()], ids=["web", "vial"])
def test_another_host_goes_on_where_one_died(run: Path, schedule: Schedule) -> None:
    old = died(run, schedule)
    machines = old.emulated.machines(STEPS / float(schedule.advance))
    found = interrupted(run, machines.controller, schedule)
    assert found.unseen < found.first <= found.unseen + 10 and found.lost == ((),)
    player = TriggeredPlayer(schedule, machines, [White()], origin=found.origin)
    player.restore(found.lost)
    with RunFolder.again(run) as folder:
        found.take_up(folder, schedule, machines.clock.now())
        assert Print(player, folder).run(found.first) is PrintState.INCOMPLETE
    assert read_run(run).shown["slot"].tolist() == list(range(len(schedule)))
    lit = old.seconds(len(schedule), turn=40 if schedule.unit == "deg" else None)
    cut = np.flatnonzero(np.abs(lit / np.median(lit) - 1) > 1e-3)
    assert set(cut) <= {found.first - 1} and (lit > 0).sum() >= len(schedule) - 1, "at most the last frame was cut"


def test_what_cannot_be_resumed_is_told(run: Path) -> None:
    schedule = roll(120)
    old = died(run, schedule)
    per_mm = STEPS / float(schedule.advance)
    controller = old.emulated.machines(per_mm).controller
    old.emulated.alps[0].disconnect()
    controller.go(5)
    controller.stop()
    with pytest.raises(BadInput, match="another program used the controller"):
        interrupted(run, old.emulated.machines(per_mm).controller, schedule)
    for zero in (0, old.emulated.controller.zero + 1):
        old.emulated.alps[0].disconnect()
        old.emulated.controller.zero = zero
        with pytest.raises(BadInput, match="has lost the print.*lost its power"):
            interrupted(run, old.emulated.machines(per_mm).controller, schedule)
    events = run / "events.jsonl"
    lines = [json.loads(line) for line in events.read_text().splitlines()]
    lines[-1]["wall"] = time.time() - 60
    events.write_text("".join(json.dumps(line) + "\n" for line in lines))
    with pytest.raises(BadInput, match="decayed"):
        interrupted(run, controller, schedule)
    old.print.folder.close()
    whole = stand(run.with_name("whole"), roll(8))
    whole.run()
    with pytest.raises(BadInput, match="is complete"):
        interrupted(whole.path, controller, schedule)


# ---- what is refused ----------------------------------------------------------------------------------------
def test_what_does_not_fit_together_is_refused() -> None:
    emulated = EmulatedMirrorRig(STEPS, MODEL)
    machines = emulated.machines(STEPS / POSE)
    with pytest.raises(BadInput, match="the rig has 1 and frames"):
        TriggeredPlayer(web(4, advance=POSE, speed=0.8, engines=(MIRRORS, MIRRORS)), machines, [White()])
    with pytest.raises(BadInput, match="whole turns"):
        roll(4).turned_again({1})

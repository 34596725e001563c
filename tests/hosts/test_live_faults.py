"""Whatever becomes of the process that plans a print, or of its camera, costs the update alone, and is told."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vamgpu.errors import BadInput, DeviceLost, StorageError
from vamgpu.hosts.emulators.clock import VirtualClock
from vamgpu.hosts.player.player import StatusPoll
from vamgpu.hosts.process import live_link as linking
from vamgpu.hosts.process.live_camera import LiveCamera
from vamgpu.hosts.process.live_link import LiveLink, LiveOrder
from vamgpu.hosts.process.order import PrintOrder
from vamgpu.hosts.process.watch import started
from vamgpu.hosts.records import plans
from vamgpu.hosts.records.record import RunRecord, read_run
from vamgpu.hosts.records.state import Board, PrintState
from vamgpu.hosts.rig import Rehearsal, carry_out, plan, read_rig, rehearsal
from vamgpu.hosts.schedules.timing import SECOND

TURNS, COUNT = 4, 36


class Live:
    """A rehearsal in virtual time, with a planning process. ``waits`` holds it up at a slot until something is so."""

    def __init__(self, job: Path, run: Path, function: str, monkeypatch: pytest.MonkeyPatch, **options: Any) -> None:
        self.run_path, self.planned = run, plan(job, read_rig("emulated"), turns=TURNS, rehearsed=True)
        self.stand: Rehearsal = rehearsal(self.planned)
        self.board, self.waits = Board(), dict[int, Callable[[LiveLink], object]]()
        self.order = LiveOrder(f"live_workers:{function}", **options)
        self.link: Any = None
        saw = LiveLink.saw

        def sees(link: LiveLink, seen: StatusPoll) -> None:
            saw(link, seen)
            self.link = link
            for slot in [slot for slot in self.waits if seen.frames and seen.frames[-1].slot >= slot]:
                until, end = self.waits.pop(slot), time.monotonic() + 30
                while not until(link):
                    assert time.monotonic() < end, (slot, link._notices, self.board.now.live)
                    time.sleep(0.005)

        monkeypatch.setattr(LiveLink, "saw", sees)

    def run(self) -> RunRecord:
        state, _ = carry_out(
            self.planned, self.stand.machines, self.run_path, self.board, live=self.order, unattended=0
        )
        assert state is PrintState.COMPLETE, self.board.now.message
        told = read_run(self.run_path)
        assert not told.shown["dark"].any() and told.shown["late"].max() < 0
        return told


def answered(count: int) -> Callable[[LiveLink], object]:
    return lambda link: link.answers >= count


def kinds(run: RunRecord) -> list[str]:
    return [event["event"] for event in run.events if event["event"].startswith(("live", "swap"))]


@pytest.fixture
def made(job: Path, run: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Live]:
    return lambda function, **options: Live(job, run, function, monkeypatch, **options)


def test_a_planning_process_replaces_coming_turns_and_ends_the_print(made: Callable[..., Live]) -> None:
    live = made("good")
    live.waits = {3: answered(1), 50: answered(2)}
    told = live.run()
    assert kinds(told) == ["swap", "swap"] and "after 3 turns" in told.message
    lit = told.shown[told.shown["frame"] >= 0]
    assert lit["version"].tolist() == [0] * COUNT + [1] * COUNT + [2] * COUNT
    down, across = live.planned.mirrors[0].place(6, 10)
    light = live.stand.emulated.recorder.seconds(0, TURNS * COUNT)[0, :, down, across].reshape(TURNS, COUNT, 6, 10)
    on = 1e-9 * int(live.planned.schedule.on[0])
    job = live.planned.jobs[0].frames
    assert job is not None
    assert np.allclose(light.sum(axis=0) * 255 / on, job.levels() + 9.0 + 5.0, atol=0.1), "what the resin saw"
    now = live.board.now
    assert (now.plan, now.stop) == (2, 3) and [each.name for each in now.parameters] == ["sensitivity"]
    frames = plans.kept_frames(live.run_path, 2, 0)
    assert (frames.levels() == 5).all() and plans.last_kept(live.run_path) == 2


@pytest.mark.slow
def test_nonsense_is_refused_and_told_and_the_print_goes_on(made: Callable[..., Live]) -> None:
    live = made("nonsense")
    live.waits = {3: answered(27)}
    told = live.run()
    whys = [event["why"] for event in told.events if event["event"] == "live refused"]
    wanted = [
        "levels from nan", "levels from -1", "256; expected 0 to 255", "inf; expected 0 to 255", r"levels [35, 6, 10]",
        "levels for 2 projectors", "times the light of a turn", "another print", "turns 0 to None", "turns 99 to None",
        "no version of the frames", "turns 1 to 1", "no version of the frames", "levels for 0 projectors",
        "another print", "parameters", "usual values in order", "no checks",
        "finite values", "no checks", "limits above 0", "no images", *3 * ["the image 'dose'"],
        "invalid message",
    ]  # fmt: skip
    assert len(whys) == len(wanted) and all(part in why for part, why in zip(wanted, whys, strict=True)), whys
    assert told.shown["version"].tolist() == [0] * COUNT + [1] * 3 * COUNT, "the one that is right was taken"
    assert plans.last_kept(live.run_path) == 1, "what is refused is not kept"
    assert not live.board.now.parameters and not live.board.now.maps and not live.board.now.checks


@pytest.mark.slow
def test_images_that_do_not_decide_are_told_and_recorded(made: Callable[..., Live]) -> None:
    live = made("doubts")
    live.waits = {3: answered(1)}
    told = live.run()
    (event,) = (event for event in told.events if event["event"] == "live doubted")
    assert "the camera moved" in event["why"] and "the images are not used" in live.board.now.live
    assert [(each.name, each.turn, each.value, each.limit) for each in live.board.now.checks] == [
        ("images", 1, 3.0, 15.0), ("conversion", 1, 0.1, 0.35), ("images", 2, 30.0, 15.0),
    ]  # fmt: skip


def test_a_killed_planning_process_leaves_the_last_version(made: Callable[..., Live]) -> None:
    live = made("dies")
    live.waits = {3: answered(1), 6: lambda link: link._gone}
    told = live.run()
    assert sorted(kinds(told)) == ["live lost", "swap"], "whichever is told first"
    assert told.shown["version"].tolist() == [0] * COUNT + [1] * 3 * COUNT
    assert "the planning process is lost" in live.board.now.live


def test_why_a_planning_process_failed_is_told(made: Callable[..., Live]) -> None:
    live = made("refuses")
    live.waits = {3: lambda link: link._gone}
    told = live.run()
    assert kinds(told) == ["live lost"] and "expected 480 × 640" in live.board.now.live


def test_one_that_never_starts_is_told(made: Callable[..., Live]) -> None:
    live = made("missing")
    live.waits = {3: lambda link: link._gone}
    told = live.run()
    assert kinds(told) == ["live lost"] and not told.shown["version"].any()


def test_a_silent_one_is_told_and_costs_nothing(made: Callable[..., Live], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(linking, "LEAVE", 0.01)
    live = made("stalls")
    told = live.run()
    assert kinds(told) == ["live silent"] and len(live.link._waiting) <= linking.WAITING
    assert not told.shown["version"].any() and live.link._process.poll() is not None, "it is ended with the print"


def test_a_version_for_a_turn_that_has_begun_is_dropped(made: Callable[..., Live]) -> None:
    live = made("late")
    live.waits = {50: answered(1)}
    told = live.run()
    assert "swap dropped" in kinds(told) and not told.shown["version"].any()


@pytest.mark.slow
def test_a_slow_disk_makes_a_version_late_and_a_full_one_refuses_it(
    made: Callable[..., Live], monkeypatch: pytest.MonkeyPatch
) -> None:
    live = made("good")
    keep, slow = plans.keep, []

    def hangs(*what: Any) -> None:
        if slow:
            raise StorageError("the disk is full")
        slow.append(True)
        end = time.monotonic() + 30
        while live.board.now.slot < 40 and time.monotonic() < end:  # turn 1 has begun
            time.sleep(0.005)
        keep(*what)

    monkeypatch.setattr(linking, "keep", hangs)
    live.waits = {42: answered(1), 50: answered(2)}
    told = live.run()
    assert sorted(kinds(told)) == ["live refused", "swap dropped"] and not told.shown["version"].any()


class Camera:
    """Images that count, as long as they are good."""

    def __init__(self, good: Callable[[], bool], then: str = "") -> None:
        self.good, self.then, self.taken = good, then, 0

    def expose(self, microseconds: float) -> None: ...

    def grab(self) -> np.ndarray:
        if not self.good() and self.then == "gone":
            raise DeviceLost("the camera's cable was pulled out")
        self.taken += self.good()
        return np.full((4, 4), self.taken % 256, np.uint8)


@pytest.mark.parametrize(("then", "event"), [("gone", "live camera lost"), ("repeat", "live images repeated")])
def test_a_camera_that_goes_or_repeats_itself_costs_its_images(
    made: Callable[..., Live], then: str, event: str
) -> None:
    live = made("counts")
    live.stand.machines.camera = Camera(lambda: live.board.now.position < 80, then)  # type: ignore[assignment]
    live.waits = {17: answered(1)}
    told = live.run()
    assert set(kinds(told)) == {event, "swap", "live ended"}
    assert told.shown["version"].tolist() == [0] * COUNT + [1] * 3 * COUNT
    images, angle = live.board.now.parameters
    assert images.value == pytest.approx(100, abs=3) and angle.value == pytest.approx(80, abs=2), (
        "each image once, 0.8 degrees apart, with the angle that it was taken at"
    )


def test_a_camera_that_repeats_itself_is_started_again() -> None:
    class Freezing(Camera):
        def flush(self) -> None:
            frozen.clear()

    frozen = [True]
    driver = Freezing(lambda: driver.taken < 3 or not frozen)
    with LiveCamera(driver, VirtualClock(), lambda: True, 40.0) as camera:  # type: ignore[arg-type]
        given = [len(camera.taken(1.0 + angle)) for angle in range(6)]
    assert given == [1, 1, 1, 0, 1, 1] and [kind for kind, _ in camera.notices()] == ["live images repeated"]


def test_a_camera_that_hangs_is_told() -> None:
    class Clock:
        real, time = True, 0

        def now(self) -> int:
            return self.time

    hangs = threading.Event()
    camera: Any = Camera(lambda: hangs.wait(30))
    clock: Any = Clock()
    with LiveCamera(camera, clock, lambda: True, 40.0) as live:
        assert not live.taken(0.0) and not live.notices()
        clock.time = 3 * SECOND
        assert not live.taken(120.0)
        assert [kind for kind, _ in live.notices()] == ["live camera silent"] and not live.taken(121.0)
        assert not live.notices(), "told once"
        hangs.set()


@pytest.mark.slow
def test_an_order_takes_it_into_the_process_that_holds_the_light(job: Path, run: Path) -> None:
    rig = read_rig("emulated", ["safety.lease=1 s"])
    order = PrintOrder.of((job,), rig, run, turns=9, speed=180.0, rehearsed=True, live=LiveOrder("live_workers:steady"))
    board = Board()
    with started(order, board) as watch:
        assert watch.wait(90)
    told = read_run(run)
    swaps = [event["version"] for event in told.events if event["event"] == "swap"]
    assert swaps and set(told.shown["version"][told.shown["frame"] >= 0].tolist()) == {0, *swaps}
    assert board.now.plan == swaps[-1]
    for turn in range(9):
        lit = told.shown[(told.shown["slot"] // COUNT == turn) & (told.shown["frame"] >= 0)]
        assert len(set(lit["version"].tolist())) == 1, "one version a turn"


def test_orders_that_make_no_sense_are_told(job: Path) -> None:
    with pytest.raises(BadInput, match="expected package.module:function"):
        LiveOrder("nothing")
    with pytest.raises(BadInput, match="allowance"):
        LiveOrder("a:b", allowance=-1)

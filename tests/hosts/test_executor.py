"""Prints on a clock that the test sets: what is shown, when the light goes out, and in which order."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from math import pi

import numpy as np
import pytest

from vamgpu.errors import BadInput, DeviceError, Underrun
from vamgpu.hosts.emulators.clock import VirtualClock
from vamgpu.hosts.executor import Executor
from vamgpu.hosts.feed import Feed
from vamgpu.hosts.limits import HdmiTiming, LensTiming, MirrorTiming
from vamgpu.hosts.moving import web
from vamgpu.hosts.schedule import NONE, Schedule
from vamgpu.hosts.sources import ArraySource
from vamgpu.hosts.spinning import VialExecutor
from vamgpu.hosts.timing import SECOND
from vamgpu.hosts.underrun import WebUnderrun
from vamgpu.hosts.video import vial

POSE = 9.0 * pi / 360
MINUTES = 10 * 60 * SECOND


class WebRig:
    """Mirrors with room for two batches, triggered as the schedule says once the web moves; and a light."""

    def __init__(self, schedule: Schedule, upload: int = 0) -> None:
        self.clock, self.schedule, self.upload = VirtualClock(), schedule, upload
        self.ends: list[int] = []
        self.codes: list[int] = []
        self.moves, self.pulses, self.stopped_after = NONE, 0, len(schedule)
        self.did: list[str] = []
        self.light = False

    def shown(self) -> int:
        count = 0 if self.moves == NONE else self.triggered(self.clock.now() - self.moves)
        assert self.pulses + count <= sum(self.ends)
        return self.pulses + count

    def triggered(self, since: int) -> int:
        return min(int(np.searchsorted(self.schedule.trigger, since, side="right")), self.stopped_after)

    def room(self) -> bool:
        passed = np.cumsum(self.ends) <= self.shown()
        return len(self.ends) - int(passed.sum()) < 2

    def put(self, pictures: np.ndarray) -> None:
        assert self.room()
        self.clock.sleep(self.upload * len(pictures))
        self.ends.append(len(pictures))
        self.codes += pictures.reshape(len(pictures), -1)[:, :4].copy().view(np.int32).ravel().tolist()

    def pulse(self) -> None:
        self.pulses += 1

    def start(self) -> None:
        self.did.append("start")
        self.moves = self.clock.now()

    def stop(self) -> None:
        self.did.append("stop")

    def on(self, power: float) -> None:
        self.light = True
        self.did.append("on")

    def off(self, why: str) -> None:
        if self.light:
            self.did.append("off")
        self.light = False


def coded(count: int) -> ArraySource:
    """Pictures that hold their number + 1."""
    return ArraySource((1 + np.arange(count)).astype(np.int32)[:, None].view(np.uint8).reshape(count, 1, 4))


def print_of(
    rig: WebRig, source: ArraySource, *, batch: int = 16, watch: Callable[[int], None] | None = None,
    policy: WebUnderrun | None = None, preroll: int = 0,
) -> tuple[Executor, Feed]:  # fmt: skip
    feed = Feed(source, rig.schedule.frame, rig, rig.clock, batch=batch, depth=4)
    executor = Executor(
        rig.schedule, feed, rig, rig, rig, rig.clock, watch=watch, policy=policy, preroll=preroll, pulse=rig.pulse
    )
    return executor, feed


def roll(poses: int, speed: float = 0.8) -> Schedule:
    return web(poses, advance=POSE, speed=speed, engines=MirrorTiming(), lens=LensTiming(), focus=(5.0, 7.0, 9.0))


def test_ten_minutes_of_web_at_48_mm_a_minute_lose_nothing() -> None:
    schedule = roll(int(MINUTES / SECOND * 0.8 / POSE))
    assert schedule.duration > 0.999 * MINUTES and len(schedule) > 18_000
    rig = WebRig(schedule, upload=5_900_000)  # 2.2 MB at 375 MB/s
    ran = print_of(rig, coded(len(schedule)))[0].run()
    assert ran.shown == len(schedule) and not ran.lost and ran.late.max() < 0
    assert np.array_equal(np.array(rig.codes), schedule.frame + 1)
    assert rig.did == ["on", "start", "off", "stop"]
    assert "0 lost" in str(ran)


def test_two_runs_are_the_same_to_the_nanosecond() -> None:
    runs = [print_of(WebRig(roll(200), 3_000_000), coded(600))[0].run() for _ in range(2)]
    assert np.array_equal(runs[0].late, runs[1].late) and runs[0].duration == runs[1].duration


class Stalling(ArraySource):
    """Takes its time for the pictures of some batches."""

    def __init__(self, count: int, rig: WebRig, stalls: dict[int, int]) -> None:
        super().__init__(coded(count)._pictures)
        self.rig, self.stalls = rig, stalls

    def read(self, frames: np.ndarray, out: np.ndarray) -> np.ndarray:
        self.rig.clock.sleep(self.stalls.get(int(frames.min()), 0))
        return super().read(frames, out)


class Torn(Feed):
    """A feed whose pictures of some slots do not come before those slots are due."""

    def hide(self, rig: WebRig, slots: set[int]) -> None:
        self._rig, self._hidden = rig, slots

    def upload(self, timeout: float = 0.0) -> bool:
        if self.uploaded in self._hidden and self.uploaded - self._rig.shown() <= 2:
            return False
        if self.uploaded in self._hidden:
            return False
        return super().upload(timeout)


def torn(slots: set[int]) -> tuple[WebRig, Executor]:
    schedule = web(1200, advance=POSE, speed=0.8, engines=MirrorTiming())
    rig = WebRig(schedule)
    feed = Torn(coded(1200), schedule.frame, rig, rig.clock, batch=1, depth=4)
    feed.hide(rig, slots)
    return rig, Executor(schedule, feed, rig, rig, rig, rig.clock, guard=1)


def test_two_lost_poses_are_black_and_the_others_keep_their_place() -> None:
    rig, executor = torn({100, 300, 700})
    ran = executor.run()
    assert [late.slot for late in ran.lost] == [100, 300, 700] and ran.shown == 1200
    wanted = 1 + np.arange(1200)
    wanted[[100, 300, 700]] = 0
    assert np.array_equal(np.array(rig.codes), wanted)


def test_the_third_in_a_turn_puts_the_light_out_and_then_stops_the_web() -> None:
    rig, executor = torn({100, 300, 459, 700})
    with pytest.raises(Underrun, match="slot 459"):
        executor.run()
    assert rig.did == ["on", "start", "off", "stop"] and not rig.light
    assert rig.shown() <= 460 and executor.ran().lost[-1].slot == 459


def test_a_stalled_source_is_borne_as_long_as_pictures_are_ahead() -> None:
    schedule = roll(400)
    ahead = 4 * 16 / schedule.rate
    rig = WebRig(schedule)
    ran = print_of(rig, Stalling(1200, rig, {592: int(0.4 * ahead * SECOND)}))[0].run()
    assert not ran.lost and ran.shown == 1200


def test_nothing_opens_the_light_before_everything_is_ahead() -> None:
    rig = WebRig(roll(100))
    executor, feed = print_of(rig, coded(300))
    seen: list[tuple[int, int]] = []
    rig.on = lambda power: seen.append((feed.uploaded, feed.made))  # type: ignore[method-assign]
    executor.run()
    assert seen == [(32, 96)]


def test_black_pictures_first_and_the_counter_must_agree() -> None:
    rig = WebRig(roll(20))
    ran = print_of(rig, coded(60), preroll=1)[0].run()
    assert ran.shown == 60 and rig.codes[:2] == [0, 1] and not ran.lost
    deaf = WebRig(roll(20))
    deaf.pulse = lambda: None  # type: ignore[method-assign]
    with pytest.raises(DeviceError, match="counted 0 triggers after 1"):
        print_of(deaf, coded(60), preroll=1)[0].run()
    assert "on" not in deaf.did and deaf.did[-1] == "stop"


def test_no_trigger_puts_the_light_out() -> None:
    rig = WebRig(roll(100))
    rig.stopped_after = 30
    with pytest.raises(DeviceError, match="no trigger for 250 ms after picture 30"):
        print_of(rig, coded(300))[0].run()
    assert rig.did == ["on", "start", "off", "stop"]
    since = rig.clock.now() - rig.moves - int(rig.schedule.trigger[29])
    assert since < 300_000_000


def test_a_trigger_that_the_mirrors_missed_ends_the_print() -> None:
    rig = WebRig(roll(100))
    feed = Feed(coded(300), rig.schedule.frame, rig, rig.clock, batch=16, depth=4)
    sent = rig.triggered
    rig.triggered = lambda since: max(sent(since) - (since > SECOND), 0)  # type: ignore[method-assign]
    executor = Executor(
        rig.schedule, feed, rig, rig, rig, rig.clock, triggers=lambda: sent(rig.clock.now() - rig.moves)
    )
    with pytest.raises(Underrun, match="sent 31 triggers, the mirrors counted 30"):
        executor.run()
    assert rig.did == ["on", "start", "off", "stop"]


class Failing(ArraySource):
    """Fails at a picture."""

    def read(self, frames: np.ndarray, out: np.ndarray) -> np.ndarray:
        if 200 in frames:
            raise DeviceError("the device that makes pictures is gone")
        return super().read(frames, out)


def test_a_source_that_fails_puts_the_light_out() -> None:
    rig = WebRig(roll(100))
    with pytest.raises(DeviceError, match="is gone"):
        print_of(rig, Failing(coded(300)._pictures))[0].run()
    assert rig.did == ["on", "start", "off", "stop"]


def test_what_the_watch_raises_ends_the_print_dark() -> None:
    rig, seen = WebRig(roll(100)), []

    def watch(slot: int) -> None:
        seen.append(slot)
        if slot >= 50:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        print_of(rig, coded(300), watch=watch)[0].run()
    assert rig.did == ["on", "start", "off", "stop"] and seen == sorted(seen)


def test_a_feed_of_another_job_is_refused() -> None:
    rig = WebRig(roll(10))
    with pytest.raises(BadInput, match="29 pictures"):
        Executor(rig.schedule, Feed(coded(30), np.arange(29), rig, rig.clock), rig, rig, rig, rig.clock)


# ---- vials -------------------------------------------------------------------------------------------------
RUN_UP = 2
"""Degrees that the stage turns before pose 0, so that pictures are under way when it gets there."""


class VialRig:
    """A stage that turns evenly, a cable with a beat, and mirrors that show each video frame one beat later."""

    def __init__(self, display: HdmiTiming, speed: Fraction = Fraction(40), slips: tuple[int, ...] = ()) -> None:
        self.clock, self.display, self.speed, self.slips = VirtualClock(), display, speed, set(slips)
        self.began, self.beats = NONE, 0
        self.lit: list[tuple[float, int]] = []
        self.did: list[str] = []

    def start(self) -> None:
        self.began = self.clock.now()

    def stop(self) -> None:
        self.did.append("stop")

    def on(self, power: float) -> None:
        self.did.append("on")

    def off(self, why: str) -> None:
        self.did.append("off")

    def degrees(self) -> Fraction:
        return (self.clock.now() - self.began) * self.speed / SECOND - RUN_UP

    def show(self, pictures: list[np.ndarray]) -> int:
        self.beats += 4 if self.beats in self.slips else 1
        self.clock.sleep_until(self.began + self.beats * SECOND // 60)
        slot = SECOND / self.display.slot_rate
        for number, picture in enumerate(pictures):
            middle = self.began + self.beats * Fraction(SECOND, 60) + SECOND // 60 + (number + Fraction(1, 2)) * slot
            where = float((middle - self.began) * self.speed / SECOND) - RUN_UP
            self.lit.append((where, int(picture[0, :4].view(np.int32)[0])))
        return 0


def spin(rig: VialRig, turns: int, ready: Callable[[int, VialRig], bool] = lambda frame, rig: True) -> VialExecutor:
    schedule = vial(360, speed=40, display=rig.display, turns=turns)
    pictures = coded(360)._pictures
    return VialExecutor(
        schedule, rig.display, lambda frame: pictures[frame] if ready(frame, rig) else None, rig, rig, rig, turns=2
    )


SMALL = HdmiTiming(pixels=(4, 1))


def test_ten_minutes_of_vial_at_40_degrees_a_second_show_each_angle_in_place() -> None:
    rig = VialRig(SMALL)
    executor = spin(rig, turns=67)
    spun = executor.run()
    assert spun.missed == 0 and rig.clock.now() > MINUTES and rig.did[-2:] == ["off", "stop"]
    where, what = np.array([lit[0] for lit in rig.lit]), np.array([lit[1] for lit in rig.lit])
    kept = what > 0
    assert np.array_equal(what[kept] - 1, np.floor(where[kept]).astype(int) % 360)
    assert (np.bincount(what[kept] - 1, minlength=360)[:359] == 67 * 3).all()
    assert (np.diff(np.flatnonzero(np.diff(what[kept]))) == 3).all()  # the cadence is even


def test_a_slipped_refresh_drops_to_the_current_angle_and_makes_amends() -> None:
    rig = VialRig(SMALL, slips=(200, 204, 500))
    spun = spin(rig, turns=2).run()
    for where, what in rig.lit:
        if what:
            # three refreshes are two poses; only the frame that waited for them can be late
            assert (int(where) - (what - 1)) % 360 <= 2
    off = sum((int(where) - (what - 1)) % 360 > 0 for where, what in rig.lit if what)
    assert 0 < off <= 3 * SMALL.patterns
    assert spun.missed > 0 and spun.owed == 0
    assert len(set(spun.slots[spun.slots != NONE].tolist())) == 360


def test_a_picture_that_is_not_ready_is_black_and_shown_in_a_turn_that_is_added() -> None:
    rig = VialRig(SMALL)
    executor = spin(rig, 1, lambda frame, rig: frame not in (100, 101) or rig.degrees() > 200)
    spun = executor.run()
    assert spun.missed == 2 and spun.owed == 0
    later = {what - 1 for where, what in rig.lit if what and where >= 360}
    assert later == {100, 101}
    assert not any(what - 1 in (100, 101) for where, what in rig.lit if what and where < 359)


def test_a_vial_that_fails_goes_dark_before_it_stops() -> None:
    rig = VialRig(SMALL)
    executor = spin(rig, 1, lambda frame, rig: 1 // (rig.degrees() < 100))  # type: ignore[arg-type,return-value]
    with pytest.raises(ZeroDivisionError):
        executor.run()
    assert rig.did.index("off") < rig.did.index("stop")
    with pytest.raises(BadInput, match="mm"):
        VialExecutor(roll(3), SMALL, lambda frame: None, rig, rig, rig)

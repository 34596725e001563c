"""Schedules: times rise, nothing overlaps, and the lens rests before there is light, on any machine that keeps pace."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from math import pi

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vamgpu.errors import BadInput, TimingInfeasible
from vamgpu.hosts.schedules.limits import HdmiTiming, LensTiming, MirrorTiming
from vamgpu.hosts.schedules.mirrors import turned, web
from vamgpu.hosts.schedules.schedule import NONE, Schedule
from vamgpu.hosts.schedules.timing import SECOND, Cadence
from vamgpu.hosts.schedules.video import vial
from vamgpu.optics.film import Film
from vamgpu.optics.lens import TunableLens
from vamgpu.optics.roller import Roller
from vamgpu.webs.display import Display
from vamgpu.webs.limits import WebLimits

POSE = 9.0 * pi / 360  # mm of a film's middle at 9 mm, half a degree

milliseconds = st.integers(0, 20_000).map(lambda count: count * 1e-6)


@st.composite
def webs(draw: st.DrawFn) -> tuple[Schedule, LensTiming, MirrorTiming]:
    """A web at a speed that is some share of the greatest."""
    planes = draw(st.integers(1, 4))
    lens = LensTiming(
        settle=draw(milliseconds), baud=draw(st.sampled_from([9600, 38400, 115200])), latency=draw(milliseconds)
    )
    mirrors = MirrorTiming(frame={8: draw(st.integers(50, 9000)) * 1e-6}, dark=draw(milliseconds))

    def built(speed: float) -> Schedule:
        return web(
            draw_poses, advance=POSE, speed=speed, engines=mirrors, lens=lens, focus=tuple(range(planes)),
            turning=turning,
        )  # fmt: skip

    draw_poses, turning = draw(st.integers(1, 40)), draw(st.booleans())
    return built(draw(st.floats(0.05, 1.0)) * greatest(built)), lens, mirrors


def greatest(built: Callable[[float], Schedule]) -> float:
    """The greatest speed a machine can do, as it says itself when asked for too much."""
    with pytest.raises(TimingInfeasible) as refused:
        built(1e6)
    return refused.value.speed


@given(webs())
@settings(max_examples=150, deadline=None)
def test_a_web_shows_every_frame_once_in_its_own_time(case: tuple[Schedule, LensTiming, MirrorTiming]) -> None:
    schedule, lens, mirrors = case
    assert (np.diff(schedule.light) > 0).all() and (schedule.command[0] == NONE or schedule.command[0] >= 0)
    assert (schedule.on > 0).all() and (schedule.dark - schedule.light == schedule.on).all()
    assert (schedule.light == schedule.trigger).all()
    assert (schedule.trigger[1:] >= schedule.dark[:-1] + mirrors.pause).all()  # no trigger into a frame
    assert (np.diff(schedule.light) >= mirrors.least(8)).all()
    assert np.array_equal(np.sort(schedule.frame), np.arange(len(schedule)))
    begins = np.array([schedule.cadence.at(int(pose)) for pose in schedule.pose])
    assert (schedule.light >= begins).all()
    assert (schedule.dark <= begins + schedule.cadence.period).all()  # a pose's light while the web is at the pose


@given(webs())
@settings(max_examples=150, deadline=None)
def test_the_lens_rests_on_the_plane_before_there_is_light(case: tuple[Schedule, LensTiming, MirrorTiming]) -> None:
    schedule, lens, _ = case
    if np.isnan(schedule.focus[0]):
        return
    assert schedule.command[0] + lens.wire + lens.settling <= schedule.light[0]
    stays = schedule.command[1:] == NONE
    assert (schedule.plane[1:] == schedule.plane[:-1])[stays].all()
    assert (schedule.focus[1:] == schedule.focus[:-1])[stays].all()
    assert (schedule.command[1:] >= schedule.dark[:-1])[~stays].all()  # the lens stays while there is light
    assert (schedule.command[1:] + lens.wire + lens.settling <= schedule.light[1:])[~stays].all()
    # the pulse comes after the last bit
    assert (schedule.trigger[1:] >= schedule.command[1:] + lens.wire)[~stays].all()


@given(
    planes=st.integers(1, 4), settle=milliseconds, share=st.integers(1, 10**6), on=st.booleans(), turning=st.booleans(),
)  # fmt: skip
@settings(max_examples=100, deadline=None)
def test_the_greatest_speed_is_the_greatest(planes: int, settle: float, share: int, on: bool, turning: bool) -> None:
    mirrors = MirrorTiming()

    def built(speed: float) -> Schedule:
        return web(
            5, advance=POSE, speed=speed, engines=mirrors, lens=LensTiming(settle), focus=tuple(range(planes)),
            on=1e-2 if on else None, turning=turning,
        )  # fmt: skip

    most = greatest(built)
    assert built(most).on.min() > 0
    with pytest.raises(TimingInfeasible):
        built(most * (1 + 1e-9 * share))


def test_nothing_drifts_in_a_million_frames() -> None:
    million = 10**6
    schedule = web(million, advance=POSE, speed=0.8, engines=MirrorTiming())
    period = Fraction(repr(POSE)) / Fraction(4, 5) * SECOND
    assert period == schedule.cadence.period
    for number in (1, 999_999):
        assert schedule.light[number] - schedule.light[0] == number * period.numerator // period.denominator
    slots = Cadence(SECOND / Fraction(120_000, 1001)).times(0, million, 3)
    assert slots[-1] == 3 * (million - 1) * SECOND * 1001 // 120_000
    # a speed whose decimal has seventeen digits leaves 64 bits, and still is exact
    odd = Cadence(Fraction(repr(pi)) * 10**7)
    assert odd.times(0, million)[-1] == (million - 1) * odd.period.numerator // odd.period.denominator
    fine = Cadence(5 + Fraction(1, 2**70 + 1))  # so fine that its parts leave 64 bits by themselves
    assert fine.times(7, 3).tolist() == [fine.at(beat) for beat in (7, 8, 9)] == [35, 40, 45]


def test_position_follows_the_frame_not_the_clock() -> None:
    schedule = web(5000, advance=POSE, speed=0.8, engines=MirrorTiming(), lens=LensTiming(), focus=(5.0, 7.0, 9.0))
    at = [float(schedule.position_at(schedule.cadence.at(k))) for k in (0, 1, 4999)]
    assert np.allclose(at, [0.0, POSE, 4999 * POSE], atol=1e-9, rtol=0)


@pytest.mark.parametrize("turning", [False, True])
def test_a_web_agrees_with_the_limits_of_its_machine(turning: bool) -> None:
    limits = WebLimits(Roller(8.8, Film(0.4, 1.5, 1.45, 1.0), pi / 360), TunableLens(), Display(turning=turning))
    schedule = web(
        100, advance=limits.advance, speed=0.8, engines=MirrorTiming(), lens=LensTiming(), focus=(5.0, 7.0, 9.0),
        turning=turning,
    )  # fmt: skip
    assert schedule.rate == pytest.approx(limits.frame_rate, rel=1e-9)
    assert schedule.duty == pytest.approx(limits.duty, rel=2e-2)  # before the first pose there is darkness
    most = greatest(
        lambda speed: web(
            9,
            advance=limits.advance,
            speed=speed,
            engines=MirrorTiming(),
            lens=LensTiming(),
            focus=(5.0, 7.0, 9.0),
            turning=turning,
        )  # fmt: skip
    )
    assert most == pytest.approx(limits.limiting.speed, rel=1e-6)


def test_the_error_names_what_binds() -> None:
    def refused(**changes: object) -> TimingInfeasible:
        with pytest.raises(TimingInfeasible, match="mm/s") as error:
            web(9, advance=POSE, speed=8, engines=MirrorTiming(), focus=(5.0, 6.0), **changes)  # pyright: ignore
        return error.value

    assert refused(lens=LensTiming(15e-3)).limit == "lens"
    assert refused(lens=LensTiming(0, baud=4800)).limit == "serial line"
    assert refused(lens=LensTiming(0)).limit == "mirrors"
    assert refused(lens=LensTiming(0), on=9e-3).limit == "light"


def video_frames(schedule: Schedule, display: HdmiTiming) -> np.ndarray:
    """Which frame each slot of every video frame shows, int64 (video frames, slots); `NONE` is black, after the end."""
    repeats = int(schedule.cadence.period * display.slot_rate / SECOND)
    shown = np.repeat(schedule.frame, repeats)
    whole = -(-shown.size // display.patterns) * display.patterns
    return np.pad(shown, (0, whole - shown.size), constant_values=NONE).reshape(-1, display.patterns)


def test_a_vial_at_forty_images_a_second_takes_three_slots_each() -> None:
    display = HdmiTiming()
    schedule = vial(360, speed=40, display=display, turns=2)
    assert len(schedule) == 720 and schedule.speed == 40 and schedule.engines == 1
    assert set(np.diff(schedule.light).tolist()) == {25_000_000}
    beat = np.round(schedule.trigger * 60 / SECOND).astype(np.int64)  # a frame waits for its video frame
    assert np.array_equal(beat, np.arange(720) * 3 // 2) and np.array_equal(schedule.trigger, beat * SECOND // 60)
    cable = video_frames(schedule, display)
    assert cable.shape == (1080, 2) and cable[:3].tolist() == [[0, 0], [0, 1], [1, 1]]
    assert np.array_equal(np.bincount(cable.ravel()), np.full(360, 6))
    delay = schedule.light - schedule.trigger
    assert delay.min() >= SECOND // 60 and delay.max() <= SECOND // 40


@given(
    images=st.integers(1, 1000), speed=st.integers(1, 4000).map(lambda n: n / 10), bits=st.sampled_from([1, 2, 4, 7, 8])
)
@settings(deadline=None)
def test_a_vial_has_whole_slots_or_is_told_which_speed_has(images: int, speed: float, bits: int) -> None:
    display = HdmiTiming(bits=bits, exposures=(1e-4,) * 7 + (Fraction(1, 120),))
    try:
        schedule = vial(images, speed=speed, display=display)
    except TimingInfeasible as error:
        assert 0 < error.speed <= speed and error.unit == "deg/s"
        schedule = vial(images, speed=error.speed, display=display)
    assert (np.diff(schedule.light) > 0).all() and (schedule.trigger >= 0).all()
    assert (schedule.dark[:-1] <= schedule.light[1:]).all() and (schedule.on > 0).all()
    assert np.array_equal(schedule.frame, np.arange(images))
    shown = video_frames(schedule, display).ravel()
    assert (np.diff(shown[shown != NONE]) >= 0).all()


def test_seven_bits_give_three_images_a_video_frame() -> None:
    schedule = vial(360, speed=180, display=HdmiTiming(bits=7))
    assert np.diff(schedule.light).min() >= SECOND // 180 and schedule.speed == 180
    with pytest.raises(BadInput, match="use fewer bits"):
        HdmiTiming(refresh=120)
    filled = vial(360, speed=20, display=HdmiTiming(bits=7, dark=230e-6))
    assert (filled.on == filled.dark + 230_000 - filled.light - 9 * 230_000).all()


def test_two_engines_wait_for_the_slower() -> None:
    fast, slow = MirrorTiming(), MirrorTiming({8: 1 / 120}, dark=1e-3)
    schedule = turned(720, speed=30, engines=(fast, slow), power=(0.5, 1.0), turns=3)
    assert schedule.power.tolist()[0] == [0.5, 1.0] and schedule.frames == 720 and len(schedule) == 2160
    assert (schedule.light == schedule.trigger).all() and schedule.unit == "deg"
    assert (schedule.dark[:-1] + slow.pause <= schedule.light[1:]).all()
    most = greatest(lambda speed: turned(720, speed=speed, engines=(fast, slow)))
    assert most == pytest.approx(0.5 / (1 / 120 + 1e-3)), "light and the pause"


def test_continuous_sla_shows_a_slice_every_pitch() -> None:
    colors = (MirrorTiming(), MirrorTiming())
    schedule = web(400, advance=0.025, speed=0.05, engines=colors, power=(1.0, 0.3), on=0.1)
    assert np.array_equal(schedule.frame, np.arange(400)) and (schedule.on == SECOND // 10).all()
    assert set(np.diff(schedule.light).tolist()) == {SECOND // 2}
    assert schedule.position[-1] == pytest.approx(399 * 0.025)
    with pytest.raises(TimingInfeasible) as error:
        web(400, advance=0.025, speed=0.5, engines=colors, on=0.1)
    assert error.value.limit == "light" and error.value.speed == pytest.approx(0.25)


def test_what_makes_no_sense_is_refused() -> None:
    with pytest.raises(BadInput, match="no lens"):
        web(3, advance=1, speed=1, engines=MirrorTiming(), focus=(1.0, 2.0))
    with pytest.raises(BadInput, match="speed"):
        web(3, advance=1, speed=float("nan"), engines=MirrorTiming())
    with pytest.raises(BadInput, match="shows 8, 1"):
        web(3, advance=1, speed=1, engines=MirrorTiming(), bits=4)
    with pytest.raises(BadInput, match="2 engines and 1 powers"):
        web(3, advance=1, speed=1, engines=(MirrorTiming(), MirrorTiming()), power=(1.0,))

"""Vials whose angles were measured: schedules that meet them at a constant speed, and prints that show them there."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import vamgpu as vam
from vamgpu.errors import BadInput, TimingInfeasible
from vamgpu.hosts.records.state import PrintState
from vamgpu.hosts.rig import carry_out, plan, read_rig, rehearsal
from vamgpu.hosts.schedules.limits import HdmiTiming, MirrorTiming
from vamgpu.hosts.schedules.mirrors import turned
from vamgpu.hosts.schedules.timing import SECOND
from vamgpu.hosts.schedules.video import vial
from vamgpu.printing.folder import load_frames, save_frames
from vamgpu.units import deg

TIMING = MirrorTiming(dark=3e-3)
MEASURED = vam.Turntable(np.array([3.0, 21.5, 44.0, 60.25, 90.0, 121.0, 200.0, 350.0]) * deg)
ARC = vam.Turntable.arc(24, 120 * deg, start=-60 * deg)


@pytest.mark.parametrize("motion", [MEASURED, ARC])
def test_frames_are_lit_from_their_angles(motion: vam.Turntable) -> None:
    schedule = turned(motion, speed=40, engines=TIMING, turns=3)
    degrees = np.degrees(motion.poses) - np.floor(np.degrees(motion.poses[0]) / 360) * 360
    assert schedule.position == pytest.approx(np.concatenate([degrees + 360 * turn for turn in range(3)]))
    assert schedule.speed == 40 and len(schedule) == 3 * motion.angles == 3 * schedule.frames
    at = [float(schedule.position_at(int(time))) for time in schedule.light]
    assert at == pytest.approx(schedule.position, abs=1e-6), "where the vial is when light begins"
    assert (np.diff(schedule.light) > 0).all() and (schedule.on == schedule.on[0]).all()
    assert (schedule.light[1:] >= schedule.dark[:-1] + TIMING.pause).all()
    assert schedule.gap == pytest.approx(float(min(np.diff(degrees).min(), 360 - np.ptp(degrees))) / 40 * SECOND, abs=2)
    assert schedule.on[0] == pytest.approx(schedule.gap - TIMING.pause, abs=2)
    assert np.array_equal(schedule.frame, np.tile(np.arange(motion.angles), 3))


def test_an_even_turntable_is_the_number_of_its_angles() -> None:
    one, other = (turned(images, speed=40, engines=TIMING, turns=2) for images in (vam.Turntable(40), 40))
    for name in ("light", "dark", "on", "frame", "pose", "position"):
        assert np.array_equal(getattr(one, name), getattr(other, name))


@pytest.mark.parametrize("images", [MEASURED, 7])
def test_a_turn_that_is_added_is_the_next_turn(images: Any) -> None:
    once, twice = (turned(images, speed=31, engines=TIMING, turns=turns) for turns in (1, 2))
    added = once.turned_again(set(range(once.frames)))
    for name in ("trigger", "light", "dark", "on", "frame", "pose", "position"):
        assert getattr(added, name) == pytest.approx(getattr(twice, name), abs=1e-9), name


def test_the_nearest_angles_decide_how_fast_a_vial_may_turn() -> None:
    with pytest.raises(TimingInfeasible, match="the slowest part is the light") as refused:
        turned(MEASURED, speed=1e4, engines=TIMING)
    most = refused.value.speed
    assert most == pytest.approx(13.0 / (1 / 266 + 3e-3), rel=1e-6), "from 350° on to 3°"
    assert turned(MEASURED, speed=most, engines=TIMING).on.min() >= TIMING.least(8)
    with pytest.raises(TimingInfeasible):
        turned(MEASURED, speed=most * 1.001, engines=TIMING)


@pytest.mark.parametrize(
    ("motion", "said"),
    [
        (vam.Turntable([0.0, 1.0, 0.5]), r"go from 57\.2958° to 28\.6479°; expected them to rise within one turn"),
        (vam.Turntable([0.0, 1.0, 1.0]), r"rise within one turn: sort .* drop"),
        (vam.Turntable(np.linspace(0, 2 * np.pi, 5)), r"go from 0° to 360°"),
        (vam.Turntable(4, dwell=[1, 2, 1, 1]), r"expected frames that are lit equally long.*Turntable without dwell"),
    ],
)
def test_angles_that_a_vial_cannot_meet_are_refused(motion: vam.Turntable, said: str) -> None:
    with pytest.raises(BadInput, match=said):
        turned(motion, speed=40, engines=TIMING)


def test_video_cables_want_even_angles() -> None:
    display = HdmiTiming()
    for motion in (MEASURED, ARC, vam.Turntable(4, dwell=[1, 2, 1, 1])):
        with pytest.raises(BadInput, match=r"a video cable got .* expected equal steps .*triggered mirrors"):
            vial(motion, speed=40, display=display)
    speed = Fraction(360) * display.slot_rate / 40 / 6
    assert len(vial(vam.Turntable(40), speed=speed, display=display)) == 40


def solved(path: Path, motion: vam.Turntable) -> vam.Projection:
    """A folder of frames at the angles of ``motion``."""
    A = vam.Projection(vam.Grid((12, 12, 6), 0.5), vam.Beam((16, 6), 0.5), motion, device="numpy")
    target = np.zeros((12, 12, 6), np.float32)
    target[3:7, 4:9, 1:5] = 1.0
    save_frames(path, vam.pack(vam.optimize(A, target, iterations=3)))
    return A


@pytest.mark.parametrize("motion", [MEASURED, ARC])
def test_a_rehearsed_print_shows_every_frame_at_its_angle(tmp_path: Path, motion: vam.Turntable) -> None:
    A = solved(tmp_path / "part.vam", motion)
    frames = load_frames(tmp_path / "part.vam", "numpy")
    assert frames.motion == motion
    planned = plan(tmp_path / "part.vam", read_rig("emulated"), speed=20, turns=2)
    places = planned.schedule.position[: motion.angles]
    assert places % 360 == pytest.approx(np.degrees(motion.poses) % 360)
    rehearsed = rehearsal(planned)
    state, _ = carry_out(planned, rehearsed.machines, tmp_path / "part.run")
    assert state is PrintState.COMPLETE
    verdict = rehearsed.monitor.verdict()
    assert verdict.greatest < 1e-3 and verdict.beside == pytest.approx(0.0, abs=1e-6)
    seen = rehearsed.seen(planned)
    assert seen.motion == motion and np.array_equal(seen.levels(), frames.levels())
    assert np.array_equal(A.T(seen.irradiance()).numpy(), A.T(frames.irradiance()).numpy())


def test_a_rig_refuses_what_its_machines_cannot_show(tmp_path: Path) -> None:
    solved(tmp_path / "part.vam", vam.Turntable(8, dwell=[1, 2, 1, 1, 1, 1, 1, 1]))
    with pytest.raises(BadInput, match="lit equally long"):
        plan(tmp_path / "part.vam", read_rig("emulated"), speed=20, turns=1)

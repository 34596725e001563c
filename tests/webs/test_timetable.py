"""Commands, triggers and light of a web machine: in order, in time, and without drift over a long web."""

from __future__ import annotations

from dataclasses import replace
from math import radians

import numpy as np
import pytest

from vamgpu.errors import BadInput
from vamgpu.optics.film import Film
from vamgpu.optics.lens import TunableLens
from vamgpu.optics.roller import Roller
from vamgpu.webs.display import Display
from vamgpu.webs.limits import WebLimits
from vamgpu.webs.timetable import TICK, timetable

PAPER = WebLimits(Roller(7.5, Film(3.0, 1.49, 1.33, 0.22), radians(0.5)), TunableLens(index=1.33))
TURNING = replace(PAPER, display=Display(turning=True))
ONE = replace(PAPER, lens=TunableLens(bins=1))
POSES = 7639


@pytest.mark.parametrize("limits", [PAPER, TURNING, ONE], ids=["three bins", "turning", "one bin"])
def test_light_is_on_only_where_the_lens_has_settled(limits: WebLimits) -> None:
    found = timetable(limits, 50)
    told = ~np.isnan(found.command)
    changes = np.diff(found.plane.ravel()) != 0
    assert np.array_equal(told.ravel()[1:], changes)
    ready = found.command + limits.display.wire + limits.lens.settle
    assert (found.start[told] >= ready[told] - 2 * TICK).all()
    assert found.start - found.trigger == pytest.approx(np.full(found.start.shape, found.delay))
    assert (found.command.ravel()[1:][changes] >= found.stop.ravel()[:-1][changes] - 1e-12).all()
    lit = found.stop - found.start
    assert np.ptp(lit) < 1e-9 and lit.min() >= 1 / limits.display.rate
    assert lit.sum() / (50 / limits.pose_rate) == pytest.approx(limits.duty, abs=5e-4)
    assert np.array_equal(found.power, limits.lens.power(np.array(limits.masks.planes))[found.plane])


@pytest.mark.parametrize("limits", [PAPER, TURNING], ids=["three bins", "turning"])
def test_nothing_drifts_over_600_millimeters(limits: WebLimits) -> None:
    tick = 1e-4  # a coarse clock, whose rounding would add up to seconds
    found = timetable(limits, POSES, tick=tick)
    slot = np.diff(found.trigger[:, 1])
    assert np.ptp(slot) > 0.9 * tick
    where = limits.speed * (found.trigger[:, 1] - found.trigger[0, 1])
    assert np.abs(where - limits.advance * np.arange(POSES)).max() <= limits.speed * tick * 1.0001
    naive = POSES * round(limits.advance / limits.speed / tick) * tick
    assert abs(naive - POSES * limits.advance / limits.speed) > 0.05


def test_a_web_may_be_timed_in_pieces() -> None:
    whole, rest = timetable(TURNING, 31), timetable(TURNING, 10, first=21)
    for name in ("plane", "power", "command", "trigger", "start", "stop"):
        np.testing.assert_array_equal(getattr(whole, name)[21:], getattr(rest, name))


def test_what_does_not_fit_is_refused_with_numbers() -> None:
    fast = replace(PAPER, speed=1.01 * PAPER.limiting.speed)
    with pytest.raises(BadInput, match=r"at 2\.327 mm/s a frame is lit for .* need 3\.759 ms.*less than 2\.304 mm/s"):
        timetable(fast, 5)
    assert timetable(replace(PAPER, speed=0.99 * PAPER.limiting.speed), 5).stop.shape == (5, 3)
    with pytest.raises(BadInput, match="first is -1"):
        timetable(PAPER, 5, first=-1)
    with pytest.raises(BadInput, match="tick"):
        timetable(PAPER, 5, tick=0.0)

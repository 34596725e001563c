"""Machines that no status poll reads: what a lens's answers vouch for, and when it is asked."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from vamgpu.errors import DeviceError
from vamgpu.hosts.emulators.clock import VirtualClock
from vamgpu.hosts.player.machine_watch import PERIOD, MachineWatch
from vamgpu.hosts.schedules.schedule import NONE
from vamgpu.hosts.schedules.timing import SECOND

STEP = SECOND // 10
POWERS = (0.0, 0.5, 1.0)


class Table:
    """A schedule of ten frames a second, whose focus changes before each."""

    gap = STEP

    def __init__(self, powers: tuple[float, ...] = POWERS, count: int = 60) -> None:
        self.light = np.arange(count) * STEP + STEP // 10
        self.focus = np.array([powers[slot % len(powers)] for slot in range(count)])
        moved = np.append(True, self.focus[1:] != self.focus[:-1])
        self.command = np.where(moved, self.light - STEP // 10, NONE)

    def __len__(self) -> int:
        return len(self.light)


class Lens:
    """A lens that follows its schedule until the line that sets it is cut, and a host that polls it."""

    def __init__(self, schedule: Any, cut: int | None = None) -> None:
        self.schedule, self.cut, self.clock = schedule, cut, VirtualClock()
        self.asked: list[int] = []
        self.watch = MachineWatch(self._answer, self.clock)

    def _answer(self) -> dict[str, object]:
        at = self.clock.now() if self.cut is None else min(self.clock.now(), int(self.schedule.command[self.cut]) - 1)
        gone = np.flatnonzero((self.schedule.command != NONE) & (self.schedule.command <= at))
        self.asked.append(self.clock.now())
        return {"focus": float(self.schedule.focus[gone[-1]])}

    def run(self, stop: int) -> None:
        """Poll every 20 ms until a slot."""
        self.watch.begin(0)
        while (slot := int(np.searchsorted(self.schedule.light, self.clock.now(), "right"))) < stop:
            if self.watch.due(slot, self.schedule, self.clock.now(), len(self.schedule)):
                self.watch.ask(slot, self.schedule)
            self.clock.sleep(SECOND // 50)


def test_a_lens_that_follows_vouches_for_what_was_shown() -> None:
    lens = Lens(Table())
    lens.run(50)
    assert 40 < lens.watch.vouched <= 50 and not lens.watch.silent


@pytest.mark.parametrize("cut", range(10, 40))
def test_a_lens_that_stopped_following_vouches_for_nothing_after_that(cut: int) -> None:
    lens = Lens(Table(), cut)
    with pytest.raises(DeviceError, match=r"the lens is at .* dpt; expected .*check the line that sets it"):
        lens.run(60)
    assert lens.watch.silent and cut - 12 < lens.watch.vouched <= cut


def test_a_lens_that_need_not_move_vouches_where_it_stands() -> None:
    lens = Lens(Table((0.5,)), cut=None)
    lens.run(30)
    assert lens.watch.vouched >= 24
    lens.watch._ask = lambda: {"focus": 0.6}
    with pytest.raises(DeviceError, match="the lens is at 0.600 dpt; expected 0.500"):
        lens.watch.ask(30, lens.schedule)


def test_it_is_asked_now_and_then_and_at_each_poll_before_the_end() -> None:
    lens = Lens(Table((0.5,)))
    lens.run(59)
    early = [at for at in lens.asked if at < 50 * STEP]
    assert np.diff(early).min() >= PERIOD and len(lens.asked) - len(early) > 10


def test_a_lamp_is_asked_at_each_poll_before_the_end_and_vouches_for_nothing_once_it_is_off() -> None:
    lamp = Lens(Table())
    lamp.watch._ask = lambda: lamp.asked.append(lamp.clock.now()) or {}
    lamp.run(59)
    early = [at for at in lamp.asked if at < 50 * STEP]
    assert np.diff(early).min() >= PERIOD and len(lamp.asked) - len(early) > 10 and lamp.watch.vouched == 58
    lamp.watch.ask(60, lamp.schedule, over=True)
    assert lamp.watch.vouched == 58
    lamp.clock.sleep(SECOND // 10)
    lamp.watch.begin(0)
    assert not lamp.watch.due(20, lamp.schedule, lamp.clock.now(), 60)
    assert lamp.watch.due(20, lamp.schedule, lamp.clock.now(), 20), "a pause is asked for"


def test_after_the_last_light_the_lens_is_where_the_last_frame_needed_it() -> None:
    lens = Lens(Table())
    lens.run(30)
    lens.watch._ask = lambda: {"focus": float(lens.schedule.focus[30])}  # the next one's, which nobody commanded
    with pytest.raises(DeviceError):
        lens.watch.ask(30, lens.schedule, over=True)

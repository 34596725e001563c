"""The controller's own line is judged before the light: rows that come too slowly would run dry in mid-print."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vamgpu.errors import BadInput, TimingInfeasible
from vamgpu.hosts.emulators.clock import VirtualClock
from vamgpu.hosts.player.controller_mirrors import PREROLL
from vamgpu.hosts.rig import check, plan, read_rig, rehearsal
from vamgpu.hosts.rigs.preflight import MARGIN, Residence, answered, preflight
from vamgpu.hosts.schedules.limits import MirrorTiming
from vamgpu.hosts.schedules.mirrors import turned
from vamgpu.hosts.schedules.schedule import Schedule
from vamgpu.printing.folder import save_frames
from vamgpu.printing.frames import Frames
from vamgpu.printing.gray import GrayCurve

FAST = MirrorTiming({8: 1e-3}, pixels=(16, 2), row_bytes=2)


class Going(VirtualClock):
    """A clock that a test sets, and that says it goes on by itself."""

    real = True


@dataclass
class Slow:
    """A controller whose every answer takes 10 ms."""

    clock: VirtualClock
    capacity: int = 32
    asked: int = 0

    def status(self) -> None:
        self.asked += 1
        self.clock.sleep(10_000_000)


def table(speed: float, images: int = 360) -> Schedule:
    return turned(images, speed=speed, engines=FAST)


def judged(schedule: Schedule, **changes: Any) -> float:
    clock = Going()
    controller: Any = Slow(clock, **changes)
    return answered(schedule, controller, clock)


def test_rows_that_the_line_carries_pass() -> None:
    assert judged(table(60)) == pytest.approx(100)


def test_rows_that_come_too_slowly_are_refused_with_the_speed_that_fits() -> None:
    with pytest.raises(TimingInfeasible, match=r"100 times per second and holds 32 of .* 1\.5 × 266 answers") as told:
        judged(table(266))
    assert (told.value.limit, told.value.unit) == ("serial line", "deg/s")
    assert told.value.speed == pytest.approx(100 / MARGIN)
    judged(table(told.value.speed * (1 - 1e-9)))
    with pytest.raises(TimingInfeasible):
        judged(table(told.value.speed * 1.01))


def test_rows_that_all_fit_into_the_controller_may_come_slowly() -> None:
    rows = 360 + PREROLL
    assert judged(table(266), capacity=rows) == pytest.approx(100)
    with pytest.raises(TimingInfeasible):
        judged(table(266), capacity=rows - 1)


def test_an_emulated_clock_tells_nothing_of_a_line() -> None:
    clock = VirtualClock()
    controller: Any = Slow(clock)
    assert answered(table(266), controller, clock) == float("inf") and controller.asked == 0
    for seconds in (None, 0, float("inf")):
        with pytest.raises(BadInput, match="seconds"):
            answered(table(266), controller, clock, seconds)  # type: ignore[arg-type]


def test_a_rig_is_checked_for_it(tmp_path: Path) -> None:
    images = np.zeros((360, 6, 10), np.uint8)
    frames = Frames.from_bytes(images, "numpy", bits=8, gray=GrayCurve.linear(), scale=1.0, columns=10)
    planned = plan(save_frames(tmp_path / "part.vam", frames).path, read_rig("emulated"), speed=120, turns=1)
    stand: Any = rehearsal(planned)
    clock = Going()
    machines = replace(stand.machines, clock=clock, controller=Slow(clock))
    with pytest.raises(TimingInfeasible, match="the controller answers") as told:
        check(planned, machines, 0.1)
    assert told.value.limit == "serial line"


def test_black_frames_before_the_first_take_memory_too() -> None:
    schedule = table(60)
    for free, wanted in (((360 + PREROLL) * 8, Residence.RESIDENT), ((360 + PREROLL) * 8 - 1, Residence.STREAMED)):
        found = preflight(schedule, FAST, 1e9, memory=free)
        assert found.residence is wanted and found.planes == (360 + PREROLL) * 8

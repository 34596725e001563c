"""A schedule as rows of a controller, and its greatest step rate."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import isnan

from vamgpu.errors import TimingInfeasible
from vamgpu.hosts.drivers.controller_protocol import FASTEST, ControllerRow
from vamgpu.hosts.schedules.schedule import NONE, Schedule

MICRO = 1000


@dataclass(frozen=True)
class RowTable:
    """Rows by slot. A row acts at the position of its lens command; without one, at that of its light."""

    schedule: Schedule
    microsteps: float  # microsteps of the motion per unit of the schedule's positions
    origin: float = 0.0  # position of pose 0, in that unit
    code: Callable[[float], int] | None = None  # code of a focal power for the lens
    channels: int = 1  # channels of light

    def acts(self, slot: int) -> int:
        """Time of a slot's row [ns of the schedule]."""
        command = int(self.schedule.command[slot])
        return int(self.schedule.light[slot]) if command == NONE else command

    def at(self, time: int) -> int:
        """The microstep at a time of the schedule [ns]."""
        return round((self.origin + float(self.schedule.position_at(time))) * self.microsteps)

    def row(self, slot: int, index: int) -> ControllerRow:
        """The row of a slot, as number ``index`` of the controller's play."""
        acts, table = self.acts(slot), self.schedule
        lens = None
        if int(table.command[slot]) != NONE and self.code is not None:
            lens = self.code(float(table.focus[slot]))
        delay = (int(table.light[slot]) - acts) // MICRO
        return ControllerRow(index, self.at(acts), lens, delay, int(table.on[slot]) // MICRO, self.channels)

    def dark(self, slot: int, before: int, index: int) -> ControllerRow:
        """A row that shows a frame without light, ``before`` a slot [ns]; the lens goes to that slot's focus."""
        focus = float(self.schedule.focus[slot])
        lens = None if self.code is None or isnan(focus) else self.code(focus)
        return ControllerRow(index, self.at(self.acts(slot) - before), lens, 0, 0, 0)


FINE = 1000  # microsteps of an emulated motion per pose, if that is not too fast


def steppable(schedule: Schedule, microsteps: float) -> None:
    """Raise `TimingInfeasible` for a motion with more microsteps per second than the controller can step."""
    rate = float(schedule.speed) * microsteps
    if rate > FASTEST:
        most, unit = FASTEST / microsteps, f"{schedule.unit}/s"
        raise TimingInfeasible(
            f"{float(schedule.speed):.4g} {unit} are {rate:.4g} microsteps/s, and the controller steps at most "
            f"{FASTEST:.4g}: move at {most:.4g} {unit} or slower, or set fewer microsteps at the motor's driver and in "
            "[motion]",
            "motor", most, unit,
        )  # fmt: skip


def emulated_microsteps(schedule: Schedule) -> int:
    """Microsteps of an emulated motion per pose: `FINE`, or as many as the controller can step."""
    return max(1, min(FINE, int(FASTEST * float(schedule.advance / schedule.speed))))

"""A schedule as the rows that a controller plays."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import isnan

from vamgpu.errors import BadInput
from vamgpu.hosts.protocols.controller import Row
from vamgpu.hosts.schedules.schedule import NONE, Schedule

MICRO = 1000


@dataclass(frozen=True)
class Rows:
    """Rows by slot. A row acts where the motion is when its lens command, or else its light, is due.

    microsteps: of the motion, in one unit of the schedule's positions; None where rows count microseconds.  origin: the
    position of pose 0, in the schedule's unit.  code: a focal power's code for the lens.  channels: of light.
    """

    schedule: Schedule
    microsteps: float | None = None
    origin: float = 0.0
    code: Callable[[float], int] | None = None
    channels: int = 1

    def __post_init__(self) -> None:
        if self.schedule.delay:
            raise BadInput(
                f"the schedule counts {self.schedule.delay} ns from trigger to light; a controller that gates the "
                "light triggers the mirrors at the same time: give the mirrors no trigger delay"
            )

    def acts(self, slot: int) -> int:
        """When a slot's row acts [ns of the schedule]."""
        command = int(self.schedule.command[slot])
        return int(self.schedule.light[slot]) if command == NONE else command

    def at(self, time: int) -> int:
        """A time of the schedule [ns] as rows count: microsteps or microseconds."""
        if self.microsteps is None:
            return time // MICRO
        return round((self.origin + float(self.schedule.position_at(time))) * self.microsteps)

    def row(self, slot: int, index: int) -> Row:
        """The row of a slot, as number ``index`` since the controller began."""
        acts, table = self.acts(slot), self.schedule
        lens = None
        if int(table.command[slot]) != NONE and self.code is not None:
            lens = self.code(float(table.focus[slot]))
        delay = (int(table.light[slot]) - acts) // MICRO
        return Row(index, self.at(acts), lens, delay, int(table.on[slot]) // MICRO, self.channels)

    def dark(self, slot: int, before: int, index: int) -> Row:
        """A row that shows a picture without light, ``before`` a slot [ns]; the lens goes to that slot's focus."""
        focus = float(self.schedule.focus[slot])
        lens = None if self.code is None or isnan(focus) else self.code(focus)
        return Row(index, self.at(self.acts(slot) - before), lens, 0, 0, 0)

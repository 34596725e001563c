"""When the bits of a frame are lit: mirrors show its planes one after the other, the highest first."""

from __future__ import annotations

from fractions import Fraction

from vamgpu.errors import BadInput
from vamgpu.hosts.schedules.limits import HdmiTiming
from vamgpu.hosts.schedules.schedule import Schedule
from vamgpu.hosts.schedules.timing import SECOND
from vamgpu.printing.planes import PlaneTime


def plane_times(schedule: Schedule, bits: int, display: HdmiTiming | None = None) -> tuple[PlaneTime, ...]:
    """Planes of a frame of a vial, lit one after the other, as shares of its step about the middle of its light."""
    if schedule.unit != "deg" or int(schedule.plane.max()) > 0:
        raise BadInput("the schedule moves a web or several focus planes; expected that of a vial with one focus")
    slot = schedule[0]
    lit, step = Fraction(slot.dark - slot.light), schedule.cadence.period
    times = 1 if display is None else max(round(step * display.slot_rate / SECOND), 1)
    worth = [Fraction(2**bit, 2**bits - 1) for bit in reversed(range(bits))]
    found = []
    for number in range(times):
        begin = lit * number / times - lit / 2
        for rank, share in enumerate(worth):
            width = lit / times * share
            found.append(PlaneTime(bits - 1 - rank, float(begin / step), float(width / step)))
            begin += width
    return tuple(found)

"""The table of a print: time, position, focus, power and duration of each frame. No I/O.

Times are whole nanoseconds since the start, computed only from the slot's number; errors therefore never add up.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from fractions import Fraction
from functools import cached_property

import numpy as np

from vamgpu.errors import BadInput, ShapeMismatch
from vamgpu.geometry import PlaneTime
from vamgpu.hosts.schedules.limits import HdmiTiming
from vamgpu.hosts.schedules.timing import SECOND, Cadence

NONE = -1  # no time or frame

COLUMNS = ("command", "trigger", "light", "dark", "on", "frame", "pose", "plane", "position", "focus")


@dataclass(frozen=True, eq=False)
class Schedule:
    """Slots in the order of time, one array each (slots,)."""

    command: np.ndarray  # time of the lens command [ns]; `NONE` if it stays
    trigger: np.ndarray  # trigger of the mirrors [ns]
    light: np.ndarray  # start of the light [ns]
    dark: np.ndarray  # end of the light [ns]
    on: np.ndarray  # true light in that time, which gives the dose [ns]
    frame: np.ndarray  # number of the frame to show
    pose: np.ndarray  # pose of the motion, counted over turns
    plane: np.ndarray  # focus plane
    position: np.ndarray  # position of the frame, in ``unit``
    focus: np.ndarray  # lens power [dpt], NaN without a lens
    power: np.ndarray  # power of the light, 0 to 1, float (slots, engines)
    cadence: Cadence  # times of the poses, and so of the motion
    advance: Fraction  # distance from pose to pose, exact; for measured angles between the nearest two
    unit: str  # "mm" or "deg"
    frames: int  # number of frames, after which a vial shows them again

    def __post_init__(self) -> None:
        for entry in fields(self):
            column = getattr(self, entry.name)
            if isinstance(column, np.ndarray):
                if len(column) != len(self.light):
                    raise ShapeMismatch(f"{entry.name} has {len(column)} slots; light has {len(self.light)}")
                column.flags.writeable = False
        if self.unit not in ("mm", "deg"):
            raise BadInput(f"unit is {self.unit!r}; expected 'mm' or 'deg'")

    def __len__(self) -> int:
        return len(self.light)

    @property
    def turns(self) -> int:
        """Turns of a vial; 0 for others."""
        return int((self.position[-1] - self.position[0]) // 360.0) + 1 if self.unit == "deg" and len(self) else 0

    @property
    def repeats(self) -> bool:
        """Whether every turn of a vial shows the same frames; frames that follow a part differ."""
        return self.turns > 0 and self.frames * self.turns == len(self)

    def turned_again(self, frames: set[int]) -> Schedule:
        """The schedule with one more turn of a vial at the end, lit only for some frames; the rest is black."""
        first = {name: getattr(self, name)[: self.frames].copy() for name in (*COLUMNS, "power")}
        turn, count = replace(self, **first), int(self.pose[-1]) + 1 - int(self.pose[0])
        if self.unit != "deg" or count % self.frames:
            raise BadInput("only whole turns of a vial can be repeated; a web has no turns")
        beats = turn.pose - turn.pose[0]
        late = self._later(count, beats)
        wanted = np.isin(turn.frame, list(frames))
        shifted = {name: getattr(turn, name) + late for name in ("trigger", "light", "dark")}
        shifted |= {
            "command": np.where(turn.command == NONE, NONE, turn.command + late), "on": np.where(wanted, turn.on, 0),
            "frame": np.where(wanted, turn.frame, NONE), "pose": turn.pose + count,
            "position": turn.position + 360.0 * (count // self.frames),
        }  # fmt: skip
        both = {name: (getattr(self, name), shifted.get(name, getattr(turn, name))) for name in (*COLUMNS, "power")}
        return replace(self, **{name: np.concatenate(parts) for name, parts in both.items()})

    def _later(self, count: int, beats: np.ndarray) -> np.ndarray:
        """Delays [ns] of the slots of a turn ``count`` poses later."""
        if self.advance * self.frames == 360:
            return np.array([self.cadence.at(count + k) - self.cadence.at(k) for k in beats.tolist()], np.int64)
        turn = Cadence(self.cadence.period / self.advance * 360)
        return np.full(beats.shape, turn.at(count // self.frames))

    @property
    def engines(self) -> int:
        """Projectors in step."""
        return self.power.shape[1]

    @property
    def duration(self) -> int:
        """Time from the start to the end of the last light [ns]."""
        return int(self.dark[-1]) if len(self) else 0

    @cached_property
    def speed(self) -> Fraction:
        """Exact speed of the motion [unit/s]: command this one, not the requested one."""
        return self.advance * SECOND / self.cadence.period

    @property
    def gap(self) -> int:
        """The least time from one light to the next [ns]; infinite for one slot."""
        return int(np.diff(self.light).min(initial=np.iinfo(np.int64).max))

    @property
    def duty(self) -> float:
        """Lit share of the time from the first light on."""
        return float(self.on.sum() / max(self.duration - int(self.light[0]), 1)) if len(self) else 0.0

    @cached_property
    def rate(self) -> float:
        """Slots per second, on average; for measured angles between the nearest two."""
        poses = int(self.pose[-1] - self.pose[0]) + 1 if len(self) else 1
        return float(len(self) * SECOND / (poses * self.cadence.period))

    def position_at(self, time: int) -> Fraction:
        """Position of the motion at a time [ns], in ``unit``, if it runs at ``speed`` and pose 0 is at position 0."""
        return (time - self.cadence.start) * self._per_nanosecond

    @cached_property
    def _per_nanosecond(self) -> Fraction:
        return self.advance / self.cadence.period


def plane_times(schedule: Schedule, bits: int, display: HdmiTiming | None = None) -> tuple[PlaneTime, ...]:
    """Planes of a vial's frame, lit one after another, as shares of its step about the middle of its light."""
    if schedule.unit != "deg" or int(schedule.plane.max()) > 0:
        raise BadInput("the schedule is for a web or several focus planes; expected that of a vial with one focus")
    lit, step = Fraction(int(schedule.dark[0] - schedule.light[0])), schedule.cadence.period
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

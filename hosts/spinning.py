"""Runs a vial before a video projector: the stage's angle chooses the picture of every slot, not the clock."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from math import floor
from typing import Protocol

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.hosts.executor import Light, Motion
from vamgpu.hosts.limits import HdmiTiming
from vamgpu.hosts.schedule import NONE, Schedule
from vamgpu.hosts.timing import SECOND
from vamgpu.hosts.underrun import VialUnderrun


class Stage(Motion, Protocol):
    """A stage that turns and says where it is."""

    def degrees(self) -> Fraction:
        """The angle from pose 0, running on over turns, from its encoder."""
        ...


class Projector(Protocol):
    """A projector on a video cable."""

    def show(self, pictures: list[np.ndarray]) -> int:
        """Put the pictures of the next video frame on the cable; returns at that refresh."""
        ...


@dataclass(frozen=True, eq=False)
class Spun:
    """How a run went.

    slots: frame that each slot of the cable showed, `NONE` for black.  missed: images that were not shown in their
    turn.  owed: those of them that no added turn showed.
    """

    slots: np.ndarray
    missed: int
    owed: int


class VialExecutor:
    """One print of a turning vial.

    picture: gives a frame's picture [row, column], or None where it is not there yet, which is black and owed.
    turns: most that are added at the end to show what was missed.  watch: called before every video frame with the
    pose; what it raises ends the print. Raises `BadInput`.
    """

    def __init__(
        self, schedule: Schedule, display: HdmiTiming, picture: Callable[[int], np.ndarray | None],
        projector: Projector, stage: Stage, light: Light, *, turns: int = 1, watch: Callable[[int], None] | None = None,
    ) -> None:  # fmt: skip
        if schedule.unit != "deg":
            raise BadInput(f"the schedule moves in {schedule.unit}; wanted that of a vial")
        self._schedule, self._display, self._picture = schedule, display, picture
        self._projector, self._stage, self._light = projector, stage, light
        self._watch = watch or (lambda pose: None)
        self._repeats = int(schedule.cadence.period * display.slot_rate / SECOND)
        columns, rows = display.pixels
        self._black = np.zeros((rows, columns), np.uint8)
        self._end = len(schedule) + turns * schedule.frames
        self.policy = VialUnderrun(schedule.frames, len(schedule))

    def run(self) -> Spun:
        """Turn and show until every image had its turns. However it ends, the light goes off first, then the stage."""
        shown: list[int] = []
        try:
            self._stage.start()
            self._light.on(float(self._schedule.power.max()))
            while not self._over(poses := self.ahead()):
                self._watch(poses[0])
                chosen = [self._frame(pose) for pose in poses]
                shown += chosen
                self._projector.show([self._shown(frame) for frame in chosen])
        except BaseException as error:
            self._light.off(f"{type(error).__name__}: {error}")
            raise
        finally:
            self._light.off("the end")
            self._stage.stop()
        return Spun(np.array(shown, np.int64), self.policy.missed, self.policy.owed)

    def ahead(self) -> tuple[int, ...]:
        """The poses at which the slots of the next video frame will be lit, from where the stage is at a refresh.

        The frame goes out at the next refresh and is lit ``latency`` later.
        """
        here = self._stage.degrees() / self._schedule.advance * self._repeats
        first = floor(here + Fraction(1, 2)) + (1 + self._display.latency) * self._display.patterns
        return tuple((first + slot) // self._repeats for slot in range(self._display.patterns))

    def _over(self, poses: tuple[int, ...]) -> bool:
        return poses[-1] >= len(self._schedule) and (poses[-1] >= self._end or not self.policy.owed)

    def _frame(self, pose: int) -> int:
        if pose < 0:
            return NONE
        frame = pose % self._schedule.frames
        return frame if self.policy.show(pose, self._picture(frame) is not None) else NONE

    def _shown(self, frame: int) -> np.ndarray:
        picture = None if frame == NONE else self._picture(frame)
        return self._black if picture is None else picture

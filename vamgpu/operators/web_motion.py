"""The motion of a web past the light, in columns per angle."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import ceil

import numpy as np

from vamgpu.errors import BadInput, SkippedColumns
from vamgpu.geometry import counts, positive
from vamgpu.web import Propagation, way_taps

DRIFT = 1e-6  # total deviation [columns] of all angles from whole columns that still counts as whole


@dataclass(frozen=True)
class WebMotion:
    """Angles along a web: angle k begins at column ``start + k·step``, which may lie between two columns."""

    poses: int
    step: float
    start: float

    @classmethod
    def past(
        cls, columns: int, window: int, step: float, poses: int | None = None, start: float | None = None
    ) -> WebMotion:
        """The angles that see a web of ``columns``, or ``poses`` of them. Raises `BadInput`, `SkippedColumns`."""
        step = positive("the step in columns a pose", step)
        if step > window:
            raise SkippedColumns(
                f"the web moves {step:g} columns per angle and the window of light is {window} columns long; turn by "
                "smaller steps or use coarser columns"
            )
        begin = float(1 - window) if start is None else float(start)
        if not np.isfinite(begin):
            raise BadInput(f"start is {start!r}; expected a finite number of columns")
        number = ceil((columns - begin) / step - DRIFT) if poses is None else counts("poses", (poses,), 1)[0]
        if number < 1:
            raise BadInput(f"start is {begin:g}, behind the {columns} columns of the web; expected less than {columns}")
        whole = round(step)
        if whole and abs(step - whole) * number < DRIFT:
            step = float(whole)
        if abs(begin - round(begin)) < DRIFT:
            begin = float(round(begin))
        return cls(number, step, begin)

    @property
    def whole(self) -> bool:
        """Whether every window begins at a column, not between two."""
        return self.step.is_integer() and self.start.is_integer()

    @property
    def positions(self) -> np.ndarray:
        """Column at which the window of each pose begins; (poses,)."""
        return self.start + self.step * np.arange(self.poses)

    @cached_property
    def neighbors(self) -> tuple[np.ndarray, np.ndarray]:
        """Column before each position, and the share in [0, 1) of the one after it."""
        positions = self.positions
        below = np.floor(positions + DRIFT)
        share = np.maximum(positions - below, 0.0)
        return below.astype(np.int64), np.where(share < DRIFT, 0.0, share)

    def taps(self, way: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Angle, column and share of whole columns about each angle, if the film moves a ``way`` while lit."""
        below, shares = self.neighbors
        near = [way_taps(way, float(share)) for share in shares]
        pose = np.repeat(np.arange(self.poses), [columns.size for columns, _ in near])
        column = np.concatenate([start + columns for start, (columns, _) in zip(below, near, strict=True)])
        return pose, column, np.concatenate([part for _, part in near])

    def lit(self, light: Propagation, columns: int) -> np.ndarray:
        """Whether each of ``columns`` gets any light at any angle; boolean (columns,)."""
        below, share = self.neighbors
        reached = np.concatenate([below, below[share > 0] + 1])
        starts = np.unique(reached)
        out = np.zeros(columns, bool)
        for l in np.unique(light.l):  # noqa: E741 - the web's axis
            column = starts + l
            out[column[(column >= 0) & (column < columns)]] = True
        return out

    def check_lit(self, light: Propagation, columns: int, whole_web: bool) -> None:
        """Raise `SkippedColumns` if a column between two lit ones (or any column of a ``whole_web``) is never lit."""
        lit = np.flatnonzero(self.lit(light, columns))
        if not lit.size:
            raise SkippedColumns(
                f"none of {columns} columns is lit at {self.poses} angles of {self.step:g} columns from "
                f"{self.start:g}; let the window pass the web"
            )
        expected = columns if whole_web else int(lit[-1] - lit[0]) + 1
        if lit.size < expected:
            span = np.arange(columns) if whole_web else np.arange(lit[0], lit[-1] + 1)
            dark = np.setdiff1d(span, lit)
            raise SkippedColumns(
                f"{dark.size} of {expected} columns are never lit, the first is column {dark[0]}: the web moves "
                f"{self.step:g} columns per angle and light reaches {np.unique(light.l).size} columns of the window; "
                "turn by smaller steps or use coarser columns"
            )

"""Positions of the segments of a web: the frames that each one decides, and the columns that it needs for that."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from math import ceil

from vamgpu.errors import BadInput
from vamgpu.geometry import positive

DENOMINATOR = 64  # greatest number of angles after which windows begin at a whole column again


@dataclass(frozen=True)
class SegmentLayout:
    """A web cut into segments of ``core`` frames, each solved with ``overlap`` more frames on either side."""

    window: int  # columns that the light of one angle reaches
    step: Fraction  # columns from one angle to the next
    core: int
    overlap: int

    @classmethod
    def of(cls, window: int, step: float, core: float = 2.0, overlap: float = 1.0) -> SegmentLayout:
        """Make a layout from lengths in windows of light. Raises `BadInput` if steps never meet whole columns again."""
        exact = Fraction(step).limit_denominator(DENOMINATOR)
        if exact <= 0 or abs(float(exact) / step - 1.0) > 1e-9:
            near = float(exact) or 1.0 / DENOMINATOR
            raise BadInput(
                f"the web moves {step:.9g} columns per angle; expected a ratio of whole numbers up to {DENOMINATOR}, "
                f"so that segments begin at whole columns: use a pitch along l of {step / near:.14g} times this one"
            )
        overlap = positive("overlap [windows]", overlap, zero=True)
        many = exact.denominator
        poses = positive("core [windows]", core) * window / step
        return cls(window, exact, many * ceil(poses / many), many * ceil(overlap * window / step / many))

    @property
    def lead(self) -> int:
        """Number of frames before the one whose window begins at column 0."""
        many = self.step.denominator
        return many * ceil((self.window - 1) / float(self.step) / many)

    @property
    def poses(self) -> int:
        """Number of angles that are solved together."""
        return self.core + 2 * self.overlap

    @property
    def columns(self) -> int:
        """Number of columns that their windows cover."""
        return ceil((self.poses - 1) * self.step) + self.window

    @property
    def columns_per_core(self) -> int:
        """Number of columns that the web moves while the frames of one segment are shown."""
        return int(self.core * self.step)

    def frames(self, columns: int) -> int:
        """Number of frames of a web with this number of columns: all whose windows meet it."""
        return self.lead + ceil(columns / self.step)

    def segments(self, columns: int) -> int:
        """Number of segments of a web with this number of columns."""
        return ceil(self.frames(columns) / self.core)

    def origin(self, segment: int) -> int:
        """Column of the web at which the columns of a segment begin; negative before the web."""
        return int((segment * self.core - self.overlap - self.lead) * self.step)

    def owned(self, segment: int, columns: int | None) -> tuple[int, int]:
        """First frame of a segment, and the one after its last; ``columns``: those of the web, None without an end."""
        first = segment * self.core
        last = first + self.core
        return first, last if columns is None else min(last, self.frames(columns))

    def printed(self, segment: int, columns: int | None) -> tuple[int, int]:
        """Columns of the web that are judged with a segment; none for the last segments."""
        first = segment * self.columns_per_core
        last = first + self.columns_per_core
        return (first, last) if columns is None else (min(first, columns), min(last, columns))

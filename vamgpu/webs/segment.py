"""What a stream gives: the frames and the target of one stretch of a web."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vamgpu.printing.frames import Frames
from vamgpu.printing.gray import GrayCurve


@dataclass(frozen=True, eq=False)
class Segment:
    """One segment that is decided.

    number: counted from 0.  first: number of its first frame on the web.  images: uint8 [pose, row, column].
    target: uint8 [l, rho, z], fractions times 255, of the columns that are judged with this segment.  scale: light of a
    full-on pixel.  loss: of the first and last iteration, overlaps included.  saturated: pixels that needed more than
    full-on.  seconds: it took.  last: whether the web ends here.  levels: least dose of the part and greatest outside,
    over the greatest, that all segments keep apart; None where no window was maximized.
    """

    number: int
    first: int
    images: np.ndarray
    target: np.ndarray
    scale: float
    loss: tuple[float, float]
    saturated: int
    seconds: float
    last: bool
    gray: GrayCurve
    levels: tuple[float, float] | None = None

    @property
    def frames(self) -> Frames:
        """The frames, for whatever shows or simulates them."""
        return Frames.from_bytes(
            self.images, "numpy", bits=8, gray=self.gray, scale=self.scale, columns=self.images.shape[2]
        )

    def __str__(self) -> str:
        return f"segment {self.number}: frames {self.first} to {self.first + len(self.images) - 1}"

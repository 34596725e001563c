"""Frames and target of one segment of a web."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vamgpu.printing.frames import Frames
from vamgpu.printing.gray import GrayCurve


@dataclass(frozen=True, eq=False)
class Segment:
    number: int  # counted from 0
    first: int  # number of its first frame on the web
    images: np.ndarray  # uint8 [pose, row, column]
    target: np.ndarray  # uint8 [l, rho, z], fractions times 255, of the columns that are judged with this segment
    scale: float  # light of a full-on pixel
    loss: tuple[float, float]  # of the first and last iteration, overlaps included
    saturated: int  # pixels that needed more than full-on
    seconds: float  # it took
    last: bool  # whether the web ends here
    gray: GrayCurve
    levels: tuple[float, float] | None = None  # least dose of the part and greatest outside

    @property
    def frames(self) -> Frames:
        """The frames, for showing or simulating them."""
        return Frames.from_bytes(
            self.images, "numpy", bits=8, gray=self.gray, scale=self.scale, columns=self.images.shape[2]
        )

    def __str__(self) -> str:
        return f"segment {self.number}: frames {self.first} to {self.first + len(self.images) - 1}"

"""The mirrors of a web machine, and the links to them and to the lens."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import Literal

from vamgpu.errors import BadInput
from vamgpu.geometry import counts
from vamgpu.schema import check
from vamgpu.schema.quantities import DataRate, Length, Rate, Time


@dataclass(frozen=True)
class Display:
    """The mirrors that show frames, and the links to them and to the lens.

    rate: highest frame rate at this number of ``bits``. bits: bits per pixel. pixels: columns, rows. pitch: pixel edge
    in the bath [mm]. wire: time to send the command for a lens power [s]. link: highest data rate from the host to the
    mirrors [bytes/s]; no limit if left out, for frames that are loaded before the print. turning: reverse the order of
    the focus planes at every other angle, which saves one lens move.

    The defaults are 8 bits on 1080p mirrors, and a lens command of ten bytes at 38,400 baud. Raises `BadInput`.
    """

    rate: Rate = 266.0
    pixels: tuple[int, int] = (1920, 1080)
    pitch: Length = 0.0144
    bits: Literal[1, 8] = 8
    wire: Time = 100 / 38400
    link: DataRate = inf
    turning: bool = False

    def __post_init__(self) -> None:
        check(self)
        object.__setattr__(self, "pixels", counts("pixels", self.pixels, 2))
        if self.bits not in (1, 8):
            raise BadInput(f"bits is {self.bits!r}; expected 1 or 8")

    @property
    def nbytes(self) -> int:
        columns, rows = self.pixels
        return rows * (columns if self.bits == 8 else -(-columns // 8))

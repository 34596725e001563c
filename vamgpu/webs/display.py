"""The mirrors of a web machine and the wires to them and to its lens."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

from vamgpu.errors import BadInput
from vamgpu.geometry import counts, positive


@dataclass(frozen=True)
class Display:
    """The mirrors that show pictures, and the wires to them and to the lens.

    rate: most pictures a second of this many ``bits``.  pixels: columns, rows.  pitch: pixel edge in the bath [mm].
    wire: seconds that the command for a lens power takes.  link: most bytes a second that reach the mirrors from the
    host; inf where all pictures are loaded before.  turning: the order of the focus planes turns at every pose, so that
    the lens moves one time less.  Defaults: 8 bits on 1080p mirrors, ten bytes at 38,400 baud. Raises `BadInput`.
    """

    rate: float = 266.0
    pixels: tuple[int, int] = (1920, 1080)
    pitch: float = 0.0144
    bits: int = 8
    wire: float = 100 / 38400
    link: float = inf
    turning: bool = False

    def __post_init__(self) -> None:
        positive("rate [1/s]", self.rate)
        positive("pitch [mm]", self.pitch)
        positive("wire [s]", self.wire, zero=True)
        if not self.link > 0:
            raise BadInput(f"link is {self.link!r} bytes a second; wanted more than 0, or inf")
        object.__setattr__(self, "pixels", counts("pixels", self.pixels, 2))
        if self.bits not in (1, 8):
            raise BadInput(f"bits is {self.bits!r}; wanted 1 or 8")

    @property
    def nbytes(self) -> int:
        """Bytes of a picture."""
        columns, rows = self.pixels
        return rows * (columns if self.bits == 8 else -(-columns // 8))

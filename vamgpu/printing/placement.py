"""Placement of frames on the beam, and the settings of their packing."""

from __future__ import annotations

from dataclasses import dataclass
from math import floor
from typing import Any

from vamgpu.errors import BadInput
from vamgpu.schema.quantities import numeric

FIT = "fit"
PAIR = "(dr, dz), two numbers of pixels"
DITHERS = ("round", "error-diffusion", FIT)


@dataclass(frozen=True)
class Placement:
    """Settings of a packing."""

    # flip_r, flip_z: mirror the frames left-right, top-bottom, for optics that mirror them back. shift: (dr, dz) in
    # pixels, whole or not, by which light is moved towards larger r and z before flips; for a projector whose image is
    # off the axis by that amount.

    flip_r: bool = False
    flip_z: bool = False
    shift: tuple[float, float] = (0.0, 0.0)
    quantile: float | None = None  # quantile of the lit pixels that a full-on pixel shows; None if not given
    dither: str = "round"  # of `DITHERS`

    def __post_init__(self) -> None:
        for name in ("flip_r", "flip_z"):
            if not isinstance(getattr(self, name), bool):
                raise BadInput(f"{name} is {getattr(self, name)!r}; expected True or False")
        shift = numeric("shift", self.shift, expected=PAIR)
        if shift.shape != (2,) or abs(shift).max() >= 1e6:
            raise BadInput(f"shift is {self.shift!r}; expected {PAIR}")
        object.__setattr__(self, "shift", tuple(shift.tolist()))
        if self.quantile is not None:
            object.__setattr__(self, "quantile", _share(self.quantile))
        if self.dither not in DITHERS:
            raise BadInput(f"dither is {self.dither!r}; expected {', '.join(map(repr, DITHERS))}")

    def arguments(self) -> dict[str, Any]:
        """Kernel arguments: whole pixels, fractions of one, and flips."""
        dr, dz = self.shift
        return {
            "shift_r": floor(dr),
            "shift_z": floor(dz),
            "part_r": dr - floor(dr),
            "part_z": dz - floor(dz),
            "flip_r": int(self.flip_r),
            "flip_z": int(self.flip_z),
        }


def _share(quantile: Any) -> float:
    try:
        share = float(quantile)
    except (TypeError, ValueError) as error:
        raise BadInput(f"quantile is {quantile!r}; expected a number") from error
    if not 0 < share <= 1:
        raise BadInput(f"quantile is {quantile!r}; expected 0 < quantile ≤ 1, where 1 scales to the brightest pixel")
    return share

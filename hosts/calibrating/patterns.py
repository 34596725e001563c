"""What mirrors show while they are measured: pictures [row, column], bool for mirrors on and off, uint8 for levels."""

from __future__ import annotations

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.geometry import counts

Shape = tuple[int, int]


def grating(shape: Shape, half_period: int = 10) -> np.ndarray:
    """A Ronchi grating: columns on and off, ``half_period`` of each in turn."""
    wide = counts("half period [columns]", (half_period,), 1)[0]
    if not 2 * wide <= shape[1]:
        raise BadInput(f"half a period of {wide} columns; wanted at most half the {shape[1]} that the mirrors have")
    return np.broadcast_to(np.arange(shape[1]) // wide % 2 == 0, shape)


def line(shape: Shape, column: int) -> np.ndarray:
    """One column on."""
    if not 0 <= column < shape[1]:
        raise BadInput(f"column {column} of {shape[1]}; wanted 0 to {shape[1] - 1}")
    return np.broadcast_to(np.arange(shape[1]) == column, shape)


def slanted(shape: Shape, angle: float = 5.0) -> np.ndarray:
    """An edge through the middle, ``angle`` [deg] from the columns; light is at its right."""
    if not 1.0 <= abs(angle) <= 40.0:
        raise BadInput(f"an edge slanted by {angle:g}°; wanted 1° to 40° from the columns")
    row, column = (np.arange(length) - 0.5 * (length - 1) for length in shape)
    return column[None, :] > np.tan(np.radians(angle)) * row[:, None]


def flat(shape: Shape, level: int) -> np.ndarray:
    """The same gray level everywhere."""
    if not 0 <= level <= 255:
        raise BadInput(f"gray level {level}; wanted 0 to 255")
    return np.full(shape, level, np.uint8)

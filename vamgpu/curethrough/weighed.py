"""Columns of a stack that are out of reach slice by slice, weighed as wholes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from vamgpu.backend.device import Device
from vamgpu.curethrough.correction import Correction, Corrector
from vamgpu.curethrough.dose import Stack, blocks
from vamgpu.errors import BadInput

StageProgress = Callable[[str, float], None]
"""Notified of progress: what is being done, and how much of it is done, 0..1."""
MOST_WEIGHED = 1 << 27
"""Bytes of columns that are weighed as wholes."""
WEIGHED_AT_ONCE = 1024


@dataclass(frozen=True, eq=False)
class Weighed:
    """Columns at pixels (rows, columns) that whole-column least squares made; levels: uint8 [slice + tail, column]."""

    rows: np.ndarray
    columns: np.ndarray
    levels: np.ndarray


def weighed(correction: Correction, stack: Stack, device: Device, progress: StageProgress) -> Weighed | None:
    """Better levels where the correction from slice to slice finds no way; None where it finds one everywhere.

    Raises `BadInput` for a printer that stops, and where so many columns are out of reach that they fill the memory.
    """
    from vamgpu.curethrough.leastsquares import least_squares

    corrector = Corrector(correction, stack.shape, device)
    for block in corrector.run(stack):
        progress("survey", 1.0 - block.start / corrector.slices)
    rows, columns = np.nonzero(corrector.missed + corrector.closed)
    if not len(rows):
        return None
    if len(rows) * stack.shape[0] > MOST_WEIGHED:
        raise BadInput(
            f"{len(rows):,} columns of {stack.shape[0]:,} slices have features or voids out of reach; expected at most "
            f"{MOST_WEIGHED // stack.shape[0]:,} to weigh: print slower or with more light, or do without least squares"
        )
    wanted = np.empty((stack.shape[0], len(rows)), np.uint8)
    for start, stop in blocks(stack.shape[0]):
        wanted[start:stop] = stack[start:stop][:, rows, columns]
    levels = np.empty((corrector.slices, len(rows)), np.uint8)
    for first in range(0, len(rows), WEIGHED_AT_ONCE):
        part = slice(first, first + WEIGHED_AT_ONCE)
        progress("columns", first / len(rows))
        levels[:, part] = least_squares(correction, np.ascontiguousarray(wanted[:, part])).levels
    return Weighed(rows, columns, levels)

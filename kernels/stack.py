"""Slices of one field in another."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from vamgpu.kernels.signature import ArrayInOut, Field, Integer, Real, Tiling, kernel

Source = Annotated[np.ndarray, Field(("i", "j", "source"))]


@kernel(over="stack", reach="first", cpu=Tiling(major=1, minor=0))
def put_slices(source: Source, first: Integer, factor: Real, keep: Integer, lanes: Integer, stack: ArrayInOut) -> None:
    """stack[i, j, first + s] = factor·source[i, j, s], added to the old value if ``keep`` is not 0."""
    # first: may be negative. lanes: of the source's layout (0 if it is plain). Other slices do not change.
    begin, end = max(first, 0), max(min(first + source.shape[2], stack.shape[2]), 0)
    room = stack[:, :, begin:end]
    room[...] = factor * source[:, :, begin - first : end - first] + (room if keep else 0.0)

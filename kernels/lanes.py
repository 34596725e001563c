"""Fields from arrays in plain C order and back, for code without lanes, and slices of one field in another."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from vamgpu.kernels.signature import Array, ArrayOut, Field, Integer, Table, Tiling, kernel

Plain = Annotated[np.ndarray, Table("float32", ("i", "j", "z"))]
Source = Annotated[np.ndarray, Field(("i", "j", "source"))]
PlainOut = Annotated[np.ndarray, Table("float32", ("i", "j", "z"), writes=True)]


@kernel(over="field", cpu=Tiling(major=1, minor=0))
def to_lanes(plain: Plain, field: ArrayOut) -> None:
    """field = plain; the padding of the last slab becomes 0."""
    field[...] = plain


@kernel(over="field", cpu=Tiling(major=1, minor=0))
def from_lanes(field: Array, plain: PlainOut) -> None:
    """plain = field, without its padding."""
    plain[...] = field


@kernel(over="field", cpu=Tiling(major=1, minor=0))
def copy_slices(source: Source, first: Integer, lanes: Integer, field: ArrayOut) -> None:
    """field[i, j, z] = source[i, j, first + z]; slices beyond the source do not change.

    lanes: of the source's layout (0 if it is plain).
    """
    begin, end = max(0, -first), min(field.shape[2], source.shape[2] - first)
    if begin < end:
        field[:, :, begin:end] = source[:, :, begin + first : end + first]

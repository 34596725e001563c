"""Fields from arrays in plain C order and back, for code without lanes."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from vamgpu.kernels.signature import Array, ArrayOut, Table, Tiling, kernel

Plain = Annotated[np.ndarray, Table("float32", ("i", "j", "z"))]
PlainOut = Annotated[np.ndarray, Table("float32", ("i", "j", "z"), writes=True)]


@kernel(over="field", cpu=Tiling(major=1, minor=0))
def to_lanes(plain: Plain, field: ArrayOut) -> None:
    """field = plain; the padding of the last slab becomes 0."""
    field[...] = plain


@kernel(over="field", cpu=Tiling(major=1, minor=0))
def from_lanes(field: Array, plain: PlainOut) -> None:
    """plain = field, without its padding."""
    plain[...] = field

"""Products with a sparse matrix whose rows are gathered: one look-up of an entry serves every z."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from vamgpu.kernels.signature import ArrayOut, Field, Table, Tiling, kernel

Source = Annotated[np.ndarray, Field(("u", "v", "z"))]
First = Annotated[np.ndarray, Table("int32", ("row",))]
"""Where the entries of (i, block, j) begin, and where the last one's end: blocks of columns fit a cache."""
Entries = Annotated[np.ndarray, Table("float32", ("entry", "2"))]
"""Column u·n_v + v and weight."""


@kernel(over="out", cpu=Tiling(major=1, minor=0), gpu=Tiling(major=1, minor=1, group=(128, 1)))
def gather_rows(source: Source, first: First, entries: Entries, out: ArrayOut) -> None:
    """out[i, j, z] = Σ of weight × source[u, v, z] over the entries of (i, j) in every block."""
    columns, values = entries[:, 0].astype(int), source.reshape(-1, source.shape[2])
    out[...] = 0.0
    blocks = (first.size - 1) // (out.shape[0] * out.shape[1])
    for row, (i, _, j) in enumerate(np.ndindex(out.shape[0], blocks, out.shape[1])):
        part = slice(first[row], first[row + 1])
        out[i, j] += entries[part, 1] @ values[columns[part]]

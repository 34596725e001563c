"""Products with a sparse matrix whose rows are gathered: one look-up of an entry serves every z."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from vamgpu.kernels.signature import ArrayOut, Field, Table, Tiling, kernel

Source = Annotated[np.ndarray, Field(("u", "v", "z"))]
First = Annotated[np.ndarray, Table("int32", ("row",))]
"""Where the entries of row i·n_j + j begin; one more says where the last one's end."""
Entries = Annotated[np.ndarray, Table("float32", ("entry", "2"))]
"""Column u·n_v + v and weight."""


@kernel(over="out", cpu=Tiling(major=1, minor=0), gpu=Tiling(major=1, minor=1, group=(128, 1)))
def gather_rows(source: Source, first: First, entries: Entries, out: ArrayOut) -> None:
    """out[i, j, z] = Σ of weight × source[u, v, z] over the entries of row i·n_j + j."""
    columns, values = entries[:, 0].astype(int), source.reshape(-1, source.shape[2])
    rows = out.reshape(-1, source.shape[2])
    for row in range(rows.shape[0]):
        part = slice(first[row], first[row + 1])
        rows[row] = entries[part, 1] @ values[columns[part]]
    out[...] = rows.reshape(out.shape)

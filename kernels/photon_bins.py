"""Sums along z of the paths of photons in the cells of rings."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from vamgpu.kernels.signature import Table, Tiling, kernel

Tally = Annotated[np.ndarray, Table("uint32", ("column", "cell", "bin", "2"), writes=True, updates=True)]
"""Paths of a column's photons in each cell, as whole numbers: their low and their high 32 bits."""
Cells = Annotated[np.ndarray, Table("float32", ("cell",))]
Basis = Annotated[np.ndarray, Table("float32", ("bin", "term"))]
WholeOut = Annotated[np.ndarray, Table("float32", ("column", "cell"), writes=True)]
LightOut = Annotated[np.ndarray, Table("float32", ("column", "cell", "term"), writes=True)]


def numbers(tally: np.ndarray) -> np.ndarray:
    """A tally as numbers."""
    return tally[..., 0].astype(float) + 2.0**32 * tally[..., 1]


@kernel(over="whole", cpu=Tiling(minor=256))
def sum_bins(tally: Tally, factor: Cells, basis: Basis, whole: WholeOut, light: LightOut) -> None:
    """whole = factor · Σ over bins of tally, light[term] = factor · Σ of basis · tally; clears the tally."""
    found = numbers(tally)
    whole[...] = factor * found.sum(axis=2)
    light[...] = factor[:, None] * (found @ basis)
    tally[...] = 0

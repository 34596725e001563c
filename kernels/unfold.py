"""Light of one angle at every angle of a moving web, and its transpose: both are one gather over a shifted window."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from vamgpu.kernels.signature import Field, Integer, Table, Tiling, kernel

Source = Annotated[np.ndarray, Field(("source_major", "source_minor", "z"))]
TargetOut = Annotated[np.ndarray, Field(("target_major", "target_minor", "z"), writes=True)]
Mixed = Annotated[np.ndarray, Field(("source_major", "i", "z"))]
MixedOut = Annotated[np.ndarray, Field(("target_major", "i", "z"), writes=True)]
Rows = Annotated[np.ndarray, Table("int32", ("row",))]
BandTable = Annotated[np.ndarray, Table("int32", ("band", "4"))]  # source minor, first major, first of weights, count
Weights = Annotated[np.ndarray, Table("float32", ("chunk", "4"))]
Indices = Annotated[np.ndarray, Table("int32", ("entry",))]
Shares = Annotated[np.ndarray, Table("float32", ("entry",))]


@kernel(
    over="target",
    cpu=Tiling(major=32, minor=0),
    gpu=Tiling(major=8, minor=1, group=(256, 1)),
    constants={"cpu": {"REGISTERS": 16}},
)
def shift_window(
    source: Source, rows: Rows, bands: BandTable, weights: Weights, step: Integer, phases: Integer, target: TargetOut
) -> None:
    """target[m·phases + c, n, z] = Σ over bands of row c·minors + n of Σ_k w[k]·source[m·step + first + k, minor]."""
    # Bands ``rows[row]`` to ``rows[row + 1]`` belong to a row; a band is (minor of the source, first, begin, count) and
    # its weights begin at ``weights[begin]``, padded to fours with zeros. Outside the source, samples count as 0.
    majors, minors = target.shape[:2]
    length, flat = source.shape[0], weights.reshape(-1)
    target[...] = 0.0
    for row in range(phases * minors):
        phase, n = divmod(row, minors)
        m = np.arange(-(-(majors - phase) // phases))
        for minor, first, begin, count in bands[rows[row] : rows[row + 1]]:
            for k in range(count):
                column = m * step + (first + k)
                inside = (column >= 0) & (column < length)
                target[m[inside] * phases + phase, n] += flat[4 * begin + k] * source[column[inside], minor]


@kernel(over="target", cpu=Tiling(major=8, minor=0), gpu=Tiling(group=(256, 1)))
def mix_poses(source: Mixed, rows: Rows, indices: Indices, shares: Shares, target: MixedOut) -> None:
    """target[m] = Σ shares[e]·source[indices[e]] over rows[m] ≤ e < rows[m + 1]: angles between two columns."""
    for m in range(target.shape[0]):
        chosen = slice(rows[m], rows[m + 1])
        target[m] = np.tensordot(shares[chosen], source[indices[chosen]], axes=1)

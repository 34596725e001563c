"""Resampling along z, between the rows of a beam and the slices of a grid."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from vamgpu.kernels.signature import ArrayOut, Field, Integer, Table, Tiling, kernel

Source = Annotated[np.ndarray, Field(("i", "j", "source"))]
Firsts = Annotated[np.ndarray, Table("int32", ("z",))]
Weights = Annotated[np.ndarray, Table("float32", ("z", "tap"))]


@kernel(
    over="target",
    reach="first",
    cpu=Tiling(major=1, minor=0),
    gpu=Tiling(major=1, minor=8, group=(128, 1)),
    constants={"cpu": {"SPAN": 256, "BESIDE": 8}, "gpu": {"QUADS": 8, "BESIDE": 4}},
)
def resample(source: Source, first: Firsts, weights: Weights, lanes: Integer, target: ArrayOut) -> None:
    """target[i, j, z] = Σ_k weights[z, k] · source[i, j, first[z] + k]; values beyond the source are 0."""
    # lanes: of the source's layout (0 if it is plain).
    matrix = np.zeros((source.shape[2], target.shape[2]))
    for k in range(weights.shape[1]):
        inside = np.flatnonzero((first + k >= 0) & (first + k < source.shape[2]))
        matrix[first[inside].astype(int) + k, inside] += weights[inside, k]
    target[...] = source @ matrix

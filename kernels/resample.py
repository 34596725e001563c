"""Resampling along z, between the rows of a beam and the slices of a grid."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from vamgpu.kernels.project import middle
from vamgpu.kernels.signature import ArrayOut, Field, Integer, Real, Tiling, kernel

Source = Annotated[np.ndarray, Field(("i", "j", "source"))]


@kernel(over="target", cpu=Tiling(major=1, minor=0))
def resample(source: Source, ratio: Real, width: Real, gain: Real, lanes: Integer, target: ArrayOut) -> None:
    """target[i, j, t] = gain · Σ_s source[i, j, s] · max(0, 1 − |s − t′| / width), t′ = t·ratio about the middles.

    lanes: of the source's layout (0 where it is plain). Swapping source and target, with 1/ratio and width/ratio,
    gives the transpose.
    """
    count, wanted = source.shape[2], target.shape[2]
    position = (np.arange(wanted) - middle(wanted)) * ratio + middle(count)
    weights = gain * np.maximum(0.0, 1.0 - np.abs(np.arange(count)[:, None] - position) / width)
    target[...] = source @ weights

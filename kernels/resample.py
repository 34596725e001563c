"""Resampling along z, between the rows of a beam and the slices of a grid."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from vamgpu.kernels.project import middle
from vamgpu.kernels.signature import ArrayOut, Field, Integer, Real, Tiling, kernel

Source = Annotated[np.ndarray, Field(("i", "j", "source"))]


@kernel(over="target", cpu=Tiling(major=1, minor=0))
def resample(
    source: Source, ratio: Real, reach: Real, most: Real, gain: Real, lanes: Integer, target: ArrayOut
) -> None:
    """target[i, j, t] = gain · Σ_s source[i, j, s] · clip(reach − |s − t′|, 0, most), t′ = t·ratio about the middles.

    With reach = (1 + w)/2 and most = 1 that is the overlap of a source sample with a target w source samples wide.

    lanes: of the source's layout (0 where it is plain). Swapping source and target, with 1/ratio, reach/ratio,
    most/ratio and gain·ratio, gives the transpose.
    """
    count, wanted = source.shape[2], target.shape[2]
    position = (np.arange(wanted) - middle(wanted)) * ratio + middle(count)
    weights = gain * np.clip(reach - np.abs(np.arange(count)[:, None] - position), 0.0, most)
    target[...] = source @ weights

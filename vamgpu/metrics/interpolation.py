"""Values between the samples of a field, linear along each axis."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from vamgpu.backend.cores import ahead

Array = npt.NDArray[np.floating]

PLANES = 32  # number of planes along x that a thread processes


def interpolated(values: Array, places: Sequence[npt.ArrayLike]) -> Array:
    """Values [x, y, z] at positions [samples from the first] along each axis; constant beyond the ends."""
    x, y, z = (np.clip(np.asarray(at, np.float64), 0.0, n - 1) for at, n in zip(places, values.shape, strict=True))
    out = np.empty((x.size, y.size, z.size), np.result_type(values, np.float32))

    def planes(first: int) -> None:
        own = x[first : first + PLANES]
        begin, end = int(own.min()), min(int(own.max()) + 2, values.shape[0])
        found = values[begin:end]
        for axis, at in ((2, z), (1, y), (0, own - begin)):
            found = _along(found, at, axis)
        out[first : first + PLANES] = found

    for _ in ahead(planes, range(0, x.size, PLANES)):
        pass
    return out


def _along(values: Array, at: npt.NDArray[np.float64], axis: int) -> Array:
    """Values at places along one axis."""
    last = values.shape[axis] - 1
    low = np.minimum(at.astype(np.int64), max(last - 1, 0))
    share = np.expand_dims((at - low).astype(np.float32), tuple(k for k in range(3) if k != axis))
    return values.take(low, axis) * (1 - share) + values.take(np.minimum(low + 1, last), axis) * share

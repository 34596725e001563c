"""Values between the samples of a field, linear along each axis."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.floating]


def interpolated(values: Array, places: Sequence[npt.ArrayLike]) -> Array:
    """Values [x, y, z] at places [samples from the first] along each axis; beyond the ends, those at the ends."""
    found = values
    for axis in (2, 1, 0):
        last = found.shape[axis] - 1
        at = np.clip(np.asarray(places[axis], np.float64), 0.0, last)
        low = np.minimum(at.astype(np.int64), max(last - 1, 0))
        share = np.expand_dims((at - low).astype(np.float32), tuple(k for k in range(3) if k != axis))
        found = found.take(low, axis) * (1 - share) + found.take(np.minimum(low + 1, last), axis) * share
    return found

"""Position of a print's surface between the voxels on either side of the part's surface."""

from __future__ import annotations

from typing import Any

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.live.fields import picked, places

PAIRS = 50_000  # greatest number of neighbors on either side of the surface that are used, spread evenly
FARTHEST = 1.5  # distance [voxels] at which the error of a surface is clipped
STEEPEST = 1e-3  # smallest decrease of the dose between neighbors, relative to the threshold, that gives a position


class Border:
    """Neighbor pairs across the part's surface, and the distance from halfway at which the dose crosses a threshold."""

    def __init__(self, part: np.ndarray, threshold: float) -> None:
        self.threshold: float = threshold
        inside = part >= 0.5
        self._shape, self._places = part.shape, dict[Device, DeviceArray]()
        number = np.arange(part.size).reshape(part.shape)
        found: list[np.ndarray] = []
        for axis in range(3):
            low, high = ((slice(None),) * axis + (cut,) for cut in (slice(None, -1), slice(1, None)))
            for here, there in ((low, high), (high, low)):
                crossed = inside[here] & ~inside[there]
                found.append(np.stack([number[here][crossed], number[there][crossed]]))
        pairs = np.concatenate(found, axis=1)
        self._pairs = pairs[:, :: max(-(-pairs.shape[1] // PAIRS), 1)]

    def off(self, dose: Any) -> float:
        """Root mean square distance [voxels] of a print's surface from the part's, at most `FARTHEST`."""
        return self._rms(*self._ends(dose))

    def share(self, had: Any, more: Any) -> float:
        """Factor, 0 to 2, on the remaining dose that brings the print's surface closest to the part's."""
        (a, b), (da, db) = self._ends(had), self._ends(more)
        best, step = 1.0, 1.0
        for shares in (40, 40):  # the second pass searches between the neighbors of the first optimum
            tried = np.clip(best + step * np.linspace(-1.0, 1.0, shares + 1), 0.0, 2.0)
            best = float(tried[np.argmin([self._rms(a + s * da, b + s * db) for s in tried])])
            step *= 2.0 / shares
        return best

    def _ends(self, dose: Any) -> tuple[np.ndarray, np.ndarray]:
        if not isinstance(dose, DeviceArray):
            inside, outside = np.asarray(dose).reshape(-1)[self._pairs].astype(float)
            return inside, outside
        if not self._pairs.size:
            return np.empty(0), np.empty(0)
        if dose.device not in self._places:
            self._places[dose.device] = places(dose.device, self._pairs.reshape(-1), self._shape)
        inside, outside = picked(dose, self._places[dose.device]).reshape(2, -1)
        return inside, outside

    def _rms(self, inside: np.ndarray, outside: np.ndarray) -> float:
        if not inside.size:
            return FARTHEST
        crossed = (inside - self.threshold) / np.maximum(inside - outside, STEEPEST * self.threshold)
        return float(np.sqrt(np.mean(np.square(np.clip(crossed - 0.5, -FARTHEST, FARTHEST)))))

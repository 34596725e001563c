"""Contrast of the effective doses in and out of a part."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from vamgpu.errors import EmptyMesh


@dataclass(frozen=True)
class EffectiveContrast:
    """Effective doses, 1 at the end of the induction, inside the part (fraction ≥ ½) and outside it."""

    in_least: float
    in_most: float
    out_most: float
    in_low: float  # fifth percentile in the part
    out_high: float  # ninety-fifth percentile out of it
    uncured: float  # share of the part below 1
    overcured: float  # share of the other voxels at 1 or above

    @property
    def window(self) -> float:
        """(Least dose in the part − greatest outside) / greatest in the part."""
        return (self.in_least - self.out_most) / max(self.in_most, 1e-30)

    @property
    def bulk(self) -> float:
        """The same with the fifth and the ninety-fifth percentile."""
        return (self.in_low - self.out_high) / max(self.in_most, 1e-30)

    @classmethod
    def of(cls, dose: Any, target: Any, counted: np.ndarray | None = None) -> EffectiveContrast:
        """Compare a dose with a target's fractions [x, y, z] where ``counted``. Raises `EmptyMesh`."""
        got, fraction = (np.asarray(value, np.float64) for value in (dose, target))
        chosen = np.ones(got.shape, bool) if counted is None else np.broadcast_to(counted, got.shape)
        part, rest = got[chosen & (fraction >= 0.5)], got[chosen & (fraction < 0.5)]
        if not part.size or not rest.size:
            raise EmptyMesh("no voxel is in the part, or none is out of it; contrast needs both")
        numbers = (part.min(), part.max(), rest.max(), np.percentile(part, 5), np.percentile(rest, 95),
                   np.mean(part < 1.0), np.mean(rest >= 1.0))  # fmt: skip
        return cls(*map(float, numbers))

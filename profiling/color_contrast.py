"""Contrast of the doses in and out of a part."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from vamgpu.errors import BadInput, EmptyMesh, ShapeMismatch


@dataclass(frozen=True)
class Contrast:
    """Doses inside the part (design ≥ ½) and outside it, relative to the greatest in the part, D_in,max."""

    in_least: float  # least and mean dose and standard deviation in the part
    in_mean: float
    in_spread: float
    out_least: float  # least, mean and greatest dose out of it
    out_mean: float
    out_most: float
    undersupply: float  # root mean squares of missing and of excess dose, all voxels
    oversupply: float
    half: float  # intersection over union of the design and the voxels of dose ½ or more
    three_quarters: float  # likewise of dose ¾ or more

    @property
    def window(self) -> float:
        """Least dose in the part − greatest dose outside: above zero, one exposure prints all of it correctly."""
        return self.in_least - self.out_most

    @property
    def mean(self) -> float:
        """Mean dose in the part − mean dose out of it."""
        return self.in_mean - self.out_mean

    @classmethod
    def of(cls, dose: Any, design: Any, counted: npt.ArrayLike | None = None) -> Contrast:
        """Compare a dose with a design [x, y, z] where ``counted``. Raises `ShapeMismatch`, `EmptyMesh`, `BadInput`."""
        got, target = (np.asarray(v.numpy() if hasattr(v, "numpy") else v, np.float64) for v in (dose, design))
        if got.shape != target.shape:
            raise ShapeMismatch(f"the dose has shape {got.shape}, the design {target.shape}; expected the same")
        chosen = np.ones(got.shape, bool) if counted is None else np.broadcast_to(np.asarray(counted, bool), got.shape)
        got, target = got[chosen], target[chosen]
        inside = target >= 0.5
        if not inside.any() or inside.all():
            raise EmptyMesh("no voxel is in the part, or none is out of it; contrast needs both")
        most = got[inside].max()
        if not most > 0:
            raise BadInput(f"the greatest dose in the part is {most:g}; expected one above 0")
        got = got / most
        gap = got - target / target.max()
        part, rest = got[inside], got[~inside]
        return cls(
            *map(float, (part.min(), part.mean(), part.std(), rest.min(), rest.mean(), rest.max())),
            *(float(np.sqrt(np.mean(np.maximum(0.0, side * gap) ** 2))) for side in (-1.0, 1.0)),
            *(float((inside & (got >= t)).sum() / (inside | (got >= t)).sum()) for t in (0.5, 0.75)),
        )

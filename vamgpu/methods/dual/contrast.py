"""How far apart the doses in and out of a part are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from vamgpu.errors import BadInput, EmptyMesh, ShapeMismatch


@dataclass(frozen=True)
class Contrast:
    """Doses in the part (design ≥ ½) and out of it, all over the greatest dose in the part, D_in,max.

    Args:
        in_least, in_mean, in_spread: Least and mean dose and its standard deviation in the part.
        out_least, out_mean, out_most: Least, mean and greatest dose out of it.
        undersupply, oversupply: Root mean square of what lacks and of what exceeds the design, all voxels.
        half, three_quarters: Ratio of the intersection to the union of design and print, where the print is what has at
            least 0.5 or 0.75.
    """

    in_least: float
    in_mean: float
    in_spread: float
    out_least: float
    out_mean: float
    out_most: float
    undersupply: float
    oversupply: float
    half: float
    three_quarters: float

    @property
    def window(self) -> float:
        """Least dose in the part − greatest dose out of it: above zero one exposure prints all of it right."""
        return self.in_least - self.out_most

    @property
    def mean(self) -> float:
        """Mean dose in the part − mean dose out of it."""
        return self.in_mean - self.out_mean

    @classmethod
    def of(cls, dose: Any, design: Any, counted: npt.ArrayLike | None = None) -> Contrast:
        """Compare a dose with a design.

        Args:
            dose, design: Dose and gray values 0..1, both [x, y, z], NumPy or on a device.
            counted: Boolean [x, y, z] or broadcast to it; None for every voxel.

        Returns:
            The contrast.

        Raises:
            ShapeMismatch: The shapes differ.
            EmptyMesh: Nothing is in the part, or nothing out of it.
            BadInput: There is no dose in the part.
        """
        got, wanted = (np.asarray(v.numpy() if hasattr(v, "numpy") else v, np.float64) for v in (dose, design))
        if got.shape != wanted.shape:
            raise ShapeMismatch(f"the dose has shape {got.shape}, the design {wanted.shape}; expected the same")
        chosen = np.ones(got.shape, bool) if counted is None else np.broadcast_to(np.asarray(counted, bool), got.shape)
        got, wanted = got[chosen], wanted[chosen]
        inside = wanted >= 0.5
        if not inside.any() or inside.all():
            raise EmptyMesh("no voxel is in the part, or none is out of it; contrast needs both")
        most = got[inside].max()
        if not most > 0:
            raise BadInput(f"the greatest dose in the part is {most:g}; expected one above 0")
        got = got / most
        gap = got - wanted / wanted.max()
        part, rest = got[inside], got[~inside]
        return cls(
            *map(float, (part.min(), part.mean(), part.std(), rest.min(), rest.mean(), rest.max())),
            *(float(np.sqrt(np.mean(np.maximum(0.0, side * gap) ** 2))) for side in (-1.0, 1.0)),
            *(float((inside & (got >= t)).sum() / (inside | (got >= t)).sum()) for t in (0.5, 0.75)),
        )

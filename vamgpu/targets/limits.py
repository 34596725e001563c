"""Required dose and weight of single voxels; some voxels have no requirement."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from vamgpu.errors import BadInput, ShapeMismatch

Array = npt.NDArray[np.floating]

NOWHERE = -1e15  # target value of a voxel that is not judged: kernels that count classes ignore values below −1e12


@dataclass(frozen=True)
class BodyRequirement:
    """The dose that the voxels of one body need, relative to the dose that prints. tolerance: that of a gray body."""

    name: str
    role: str
    dose: float = 1.0
    tolerance: float = 0.2


@dataclass(frozen=True, eq=False)
class Limits:
    """Limit of the dose, weight and body of each voxel: the part must reach its limit, others must stay below."""

    dose: Array  # limit [x, y, z], relative to the dose that prints; 0 where nothing is judged
    weight: Array  # in losses, [x, y, z], ≥ 0
    body: npt.NDArray[np.integer]  # number of a voxel's body [x, y, z], −1 for none
    bodies: tuple[BodyRequirement, ...]
    void: float = 1.0  # limit of voxels without a body

    def __post_init__(self) -> None:
        shapes = {np.shape(field) for field in (self.dose, self.weight, self.body)}
        if len(shapes) != 1 or len(next(iter(shapes))) != 3:
            raise ShapeMismatch(f"limits have shapes {sorted(shapes)}; expected one shape [x, y, z] of all three")
        for name, values in (("dose", self.dose), ("weight", self.weight)):
            if not (np.isfinite(values).all() and np.min(values) >= 0.0):
                raise BadInput(f"limits hold a {name} that is negative or not a number; expected finite values ≥ 0")
        if not 0.0 < self.void < np.inf:
            raise BadInput(f"void is {self.void!r}; expected a limit above 0, as a share of the dose that prints")
        if np.min(self.body) < -1 or np.max(self.body) >= len(self.bodies):
            raise BadInput(f"limits name bodies {np.min(self.body)}..{np.max(self.body)}; there are {len(self.bodies)}")

    @cached_property
    def judged(self) -> npt.NDArray[np.bool_]:
        """Voxels with a requirement, [x, y, z]."""
        return self.dose > 0.0

    @cached_property
    def scale(self) -> npt.NDArray[np.float32]:
        """Factor of the dose at each voxel that makes one limit hold for all, [x, y, z]; 0 where nothing is judged."""
        return np.divide(1.0, self.dose, out=np.zeros(self.dose.shape, np.float32), where=self.judged)

    @property
    def weighted(self) -> bool:
        """Whether a weight of any judged voxel is not 1."""
        return bool((self.weight[self.judged] != 1.0).any())

    @cached_property
    def gray(self) -> npt.NDArray[np.bool_]:
        """Voxels whose dose must match their limit and not exceed it, [x, y, z]."""
        roles = np.array([body.role == "gray" for body in self.bodies] + [False])
        return roles[self.body]

    def stacked(self, times: int) -> Limits:
        """The same limits for several volumes stacked along z."""
        tall = {name: np.tile(getattr(self, name), (1, 1, times)) for name in ("dose", "weight", "body")}
        return replace(self, **tall)

    def classes(self, fraction: Array) -> npt.NDArray[np.float32]:
        """The fractions, and `NOWHERE` where nothing is judged, [x, y, z]."""
        return np.where(self.judged, fraction, NOWHERE).astype(np.float32)

    def at(self, field: Array, pitch: float) -> Callable[[Array, Array, Array], Array]:
        """A field of these voxels at other places: the value of the nearest voxel."""

        def nearest(*places: Array) -> Array:
            index = [
                np.clip(np.rint(np.asarray(at) / pitch + 0.5 * (count - 1)).astype(int), 0, count - 1)
                for at, count in zip(places, field.shape, strict=True)
            ]
            return field[np.ix_(*index)]

        return nearest

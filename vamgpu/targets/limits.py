"""What single voxels are asked for: a dose of their own, a weight, or nothing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from vamgpu.errors import BadInput, ShapeMismatch

Array = npt.NDArray[np.floating]

NOWHERE = -1e15
"""Target of a voxel that is not judged: kernels that count classes leave out what is below −1e12."""
DESCRIBED = ("name", "role", "dose", "tolerance")


@dataclass(frozen=True)
class Asked:
    """One body, as its voxels are judged.

    Args:
        name: Of the body.
        role: ``print``, ``gray``, ``keep out``, ``don't care`` or ``insert``.
        dose: Asked for, or the limit; relative to the dose of what is printed.
        tolerance: Of a gray dose, a share of it.
    """

    name: str
    role: str
    dose: float = 1.0
    tolerance: float = 0.2

    def described(self) -> dict[str, str | float]:
        """Its fields in plain values."""
        return {key: getattr(self, key) for key in DESCRIBED}


@dataclass(frozen=True, eq=False)
class Limits:
    """Per voxel: the dose that is its limit, a weight, and the body that it belongs to.

    A voxel of the part is to reach its limit, every other one is to stay below; 1 is the dose of what is printed.

    Args:
        dose: Limit of every voxel above 0, or 0 where nothing is asked and nothing judged, [x, y, z].
        weight: In losses, [x, y, z], ≥ 0.
        body: Number of the body that a voxel belongs to, −1 for none, integers [x, y, z].
        bodies: The bodies, by number.
        void: Limit of what belongs to no body; resin gets solid from this share of the threshold on.

    Raises:
        BadInput: A value is out of its range.
        ShapeMismatch: Fields of different shapes.
    """

    dose: Array
    weight: Array
    body: npt.NDArray[np.integer]
    bodies: tuple[Asked, ...]
    void: float = 1.0

    def __post_init__(self) -> None:
        shapes = {np.shape(field) for field in (self.dose, self.weight, self.body)}
        if len(shapes) != 1 or len(next(iter(shapes))) != 3:
            raise ShapeMismatch(f"limits have shapes {sorted(shapes)}; expected one shape [x, y, z] of all three")
        for name, values in (("dose", self.dose), ("weight", self.weight)):
            if not (np.isfinite(values).all() and np.min(values) >= 0.0):
                raise BadInput(f"limits hold a {name} below 0 or no number; expected finite values ≥ 0")
        if not 0.0 < self.void < np.inf:
            raise BadInput(f"void is {self.void!r}; expected a limit above 0, as a share of the dose that prints")
        if np.min(self.body) < -1 or np.max(self.body) >= len(self.bodies):
            raise BadInput(f"limits name bodies {np.min(self.body)}..{np.max(self.body)}; there are {len(self.bodies)}")

    @cached_property
    def judged(self) -> npt.NDArray[np.bool_]:
        """Which voxels are asked for anything, [x, y, z]."""
        return self.dose > 0.0

    @cached_property
    def scale(self) -> npt.NDArray[np.float32]:
        """What a dose is multiplied by to be compared with one limit for all, [x, y, z]; 0 where nothing is asked."""
        return np.divide(1.0, self.dose, out=np.zeros(self.dose.shape, np.float32), where=self.judged)

    @property
    def weighted(self) -> bool:
        """Whether a weight of any judged voxel is not 1."""
        return bool((self.weight[self.judged] != 1.0).any())

    @cached_property
    def gray(self) -> npt.NDArray[np.bool_]:
        """Which voxels are to get their limit and no more, [x, y, z]."""
        roles = np.array([body.role == "gray" for body in self.bodies] + [False])
        return roles[self.body]

    def stacked(self, times: int) -> Limits:
        """The same limits in several volumes, one above the other.

        Args:
            times: How many.

        Returns:
            The limits, [x, y, times · z].
        """
        tall = {name: np.tile(getattr(self, name), (1, 1, times)) for name in ("dose", "weight", "body")}
        return replace(self, **tall)

    def classes(self, fraction: Array) -> npt.NDArray[np.float32]:
        """The fractions, and `NOWHERE` where nothing is judged, [x, y, z]."""
        return np.where(self.judged, fraction, NOWHERE).astype(np.float32)

    def at(self, field: Array, pitch: float) -> Callable[[Array, Array, Array], Array]:
        """A field of these voxels at other places: that of the nearest voxel.

        Args:
            field: Values [x, y, z].
            pitch: Edge of a voxel [mm].

        Returns:
            A function of places x, y, z [mm], each (n,), about the middle of the grid.
        """

        def nearest(*places: Array) -> Array:
            index = [
                np.clip(np.rint(np.asarray(at) / pitch + 0.5 * (count - 1)).astype(int), 0, count - 1)
                for at, count in zip(places, field.shape, strict=True)
            ]
            return field[np.ix_(*index)]

        return nearest

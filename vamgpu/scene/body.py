"""A body of a scene: its shape, and the required dose of its voxels."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.geometry import Grid, positive
from vamgpu.schema.quantities import Absorption, measured
from vamgpu.schema.registry import nearest
from vamgpu.targets.implicit import Implicit
from vamgpu.targets.implicit import voxelize as filled
from vamgpu.targets.limits import BodyRequirement
from vamgpu.targets.mesh import solid_of
from vamgpu.targets.solid import Solid
from vamgpu.targets.target import Target
from vamgpu.targets.voxelize import voxelize

if TYPE_CHECKING:
    import trimesh

    Source = str | Path | Solid | trimesh.Trimesh | npt.NDArray[Any] | Implicit

PRIORITIES: dict[str, float] = {"print": 0.0, "gray": 10.0, "don't care": 20.0, "keep out": 30.0, "insert": 40.0}
"""Role → default priority where bodies overlap."""
PRINTED = ("print", "gray")
FREE = ("insert", "don't care")  # roles without a required dose
_DOSED = ("gray", "keep out")
MOST_DOSE = 10.0  # greatest dose of a gray body: a greater one is probably not a share


@dataclass(frozen=True)
class Place:
    """Transform from the CAD frame to the vial's: place = factor · rotation · CAD + move."""

    factor: float
    rotation: npt.NDArray[np.float64] | None
    move: tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Body:
    """A shape in the CAD frame and its role; see `Scene`.

    Args:
        source: Path of a mesh file, a `Solid`, a `trimesh.Trimesh`, a mask [x, y, z] of fractions or booleans about the
            CAD origin, or a function φ(x, y, z) [mm], negative inside.
        role: ``print``, ``gray``, ``keep out``, ``don't care`` or ``insert``.
        name: Name in messages and reports; by default that of the file, or else the role.
        dose: For ``gray`` the required dose, for ``keep out`` the limit, relative to the dose that prints.
        tolerance: Allowed deviation of a gray dose, a share of it.
        weight: Weight of its voxels in methods that minimize a loss, above 0.
        priority: Where bodies overlap, the one with the higher priority gets the voxels; by default the role's.
        index: Refractive index of a transparent insert, dimensionless.
        absorption: Absorption of a transparent insert [1/mm]; like ``pitch`` also text with its unit.
        pitch: Edge of a mask's voxels [mm].

    Raises:
        BadInput: A value is out of its range, or does not apply to the role.
        MeshError: The mesh cannot be read or repaired.
        EmptyMesh: The mesh is empty.
    """

    source: Any
    role: str = "print"
    name: str | None = None
    dose: float | None = None
    tolerance: float = 0.2
    weight: float = 1.0
    priority: float | None = None
    index: float | None = None
    absorption: float | None = None
    pitch: float | None = None

    def __post_init__(self) -> None:
        role, expected = str(self.role).replace("_", " ").replace("-", " "), ", ".join(PRIORITIES)
        if role not in PRIORITIES:
            close = nearest(role, PRIORITIES)
            raise BadInput(f"no role {self.role!r} of a body; expected one of {expected}{close}")
        shape = self._read()
        given = {"role": role, "source": shape, "name": self.name or getattr(shape, "name", None) or role}
        given["priority"] = PRIORITIES[role] if self.priority is None else self.priority
        for key, value in given.items():
            object.__setattr__(self, key, value)
        self._check(f"body {self.name!r}")

    def _read(self) -> Solid | Target | Implicit:
        """The shape of the source."""
        source = self.source
        if isinstance(source, np.ndarray):
            if self.pitch is None:
                raise BadInput("a body is a mask without pitch; give pitch= [mm], the edge of its voxels")
            mask = Target.from_array(source, self.pitch, self.name or self.role)
            object.__setattr__(self, "pitch", mask.grid.pitch)
            return mask
        if self.pitch is not None:
            raise BadInput(f"got pitch={self.pitch} for a {type(source).__name__}; expected it only for masks")
        if (solid := solid_of(source, self.name or self.role)) is not None:
            return solid
        if not isinstance(source, Implicit):
            raise BadInput(
                f"got a {type(source).__name__} as body; expected the path of a mesh file, a Solid, a trimesh.Trimesh, "
                "a NumPy mask with pitch=, or a function φ(x, y, z)"
            )
        return source

    def _check(self, who: str) -> None:
        """Raise `BadInput` for invalid numbers, or for numbers that do not apply to the role."""
        if not isinstance(self.priority, (int, float)) or not isfinite(self.priority):
            raise BadInput(f"priority of {who} is {self.priority!r}; expected a number")
        positive(f"weight of {who}", self.weight)
        positive(f"tolerance of {who}", self.tolerance)
        if self.role in _DOSED and self.dose is None:
            raise BadInput(f"{who} is {self.role!r} without a dose; give dose=, a share of the dose that prints")
        if self.dose is not None:
            most = 1.0 if self.role == "keep out" else MOST_DOSE
            if positive(f"dose of {who}", self.dose) > most:
                raise BadInput(f"dose of {who} is {self.dose:g}; expected a share of the dose that prints, {most:g} at "
                               "most: 70 % of it is 0.7")  # fmt: skip
        alone = {"dose": _DOSED, "index": ("insert",), "absorption": ("insert",)}
        for key, roles in alone.items():
            value = getattr(self, key)
            if value is not None and self.role not in roles:
                raise BadInput(f"got {key}={value} for {who}, which is {self.role!r}; expected it only for {roles}")
        if self.index is not None and not 1.0 <= positive(f"index of {who}", self.index) < 10.0:
            raise BadInput(f"index of {who} is {self.index:g}; expected a refractive index of at least 1")
        if self.absorption is not None:
            object.__setattr__(self, "absorption", measured(f"absorption of {who}", self.absorption, Absorption))

    @property
    def opaque(self) -> bool:
        """Whether it is an insert that stops the light."""
        return self.role == "insert" and self.index is None and self.absorption is None

    @property
    def requirement(self) -> BodyRequirement:
        """Required dose of its voxels."""
        return BodyRequirement(str(self.name), self.role, 1.0 if self.dose is None else self.dose, self.tolerance)

    def summary(self, place: Place) -> str:
        """Its role and extent, in words.

        Args:
            place: Transform of the CAD frame.

        Returns:
            For example "gray, dose 0.7, to 2.1 mm from the axis, z −1 to 3 mm".
        """
        reach = self.reach(place)
        dose = "" if self.dose is None else f", dose {self.dose:g}"
        where = "by a function" if reach is None else "to {:.4g} mm from the axis, z {:.4g} to {:.4g} mm".format(*reach)
        return f"{self.role}{dose}, {where}"

    def solid(self, place: Place) -> Solid | None:
        """The surface in the vial.

        Args:
            place: Transform of the CAD frame.

        Returns:
            The surface [mm]; None for masks and functions.
        """
        if not isinstance(self.source, Solid):
            return None
        return self.source.placed(rotation=place.rotation, factor=place.factor, center=False).translated(place.move)

    def reach(self, place: Place) -> tuple[float, float, float] | None:
        """Extent of the body.

        Args:
            place: Transform of the CAD frame.

        Returns:
            Greatest distance from the axis, lowest and highest z [mm]; None for functions, whose extent is unknown.
        """
        solid = self.solid(place)
        if solid is not None:
            low, high = solid.bounds
            return solid.radius, float(low[2]), float(high[2])
        if isinstance(self.source, Target):
            grid, z = self.source.grid, np.flatnonzero(self.source.numpy().any(axis=(0, 1)))
            low, high = (place.factor * grid.pitch * (end - 0.5 * grid.shape[2]) for end in (z[0], z[-1] + 1))
            away = float(np.hypot(*place.move[:2])) + place.factor * self.source.radius
            return away, float(low) + place.move[2], float(high) + place.move[2]
        return None

    def fractions(self, grid: Grid, place: Place, device: Device) -> npt.NDArray[np.float32]:
        """The share of every voxel that it fills.

        Args:
            grid: The voxels; parts of the body outside are cut off.
            place: Transform of the CAD frame.
            device: Device that voxelizes meshes.

        Returns:
            Shares [x, y, z].

        Raises:
            BadInput: A mask is to be turned.
        """
        solid = self.solid(place)
        if solid is not None:
            return voxelize(solid, grid, device).fraction.numpy()
        if isinstance(self.source, Target):
            if place.rotation is not None:
                raise BadInput(f"body {self.name!r} is a mask, which cannot be turned; give it in the turned frame")
            mask = Target.from_array(self.source.numpy(), place.factor * self.source.grid.pitch)
            x, y, z = (-move for move in place.move)
            return mask.resampled(grid, (x, y, z), device).numpy()
        return filled(self.placed(place), grid)

    def placed(self, place: Place) -> Any:
        """The function in the vial's coordinates.

        Args:
            place: Transform of the CAD frame.

        Returns:
            φ(x, y, z).
        """
        turn = np.eye(3) if place.rotation is None else np.asarray(place.rotation, np.float64)

        def shape(*points: Any) -> Any:
            there = [(at - move) / place.factor for at, move in zip(points, place.move, strict=True)]
            x, y, z = (sum(turn[k, axis] * there[k] for k in range(3) if turn[k, axis]) for axis in range(3))
            x, y, z = np.broadcast_arrays(x, y, z)
            try:
                value = np.asarray(self.source(x, y, z), np.float64)
            except (TypeError, ValueError) as error:
                raise BadInput(f"the function of body {self.name!r}: {error}; expected φ(x, y, z) of three arrays [mm] "
                               "that gives an array of their shape") from error  # fmt: skip
            return np.broadcast_to(value, x.shape) if value.shape == () else value

        return shape

"""Lattices of struts: true distances outside and inside one strut; inside a joint, at most the distance.

Each is symmetric about the planes of its smallest region: the nearest strut belongs to the point's own region.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from math import sqrt
from typing import Any

import numpy as np
import numpy.typing as npt

from vamgpu.errors import BadInput
from vamgpu.geometry import positive
from vamgpu.targets.implicit import Distance

Array = npt.NDArray[np.float64]

_TETRAHEDRON = ((0.0, 0.0, 0.0), (0.5, 0.5, 0.0), (0.5, 0.0, 0.5), (0.0, 0.5, 0.5))
_BONDS = ((-1.0, -1.0, -1.0), (-1.0, 1.0, 1.0), (1.0, -1.0, 1.0), (1.0, 1.0, -1.0))


@dataclass(frozen=True)
class CubicLattice(Distance):
    """Round struts along the edges of cubes.

    Args:
        cell: Edge of a cube [mm].
        strut: Diameter of a strut [mm].
    """

    cell: float = 3.0
    strut: float = 0.5

    def __post_init__(self) -> None:
        _thin(self, "strut", self.strut, self.cell)

    def __call__(self, x: Array, y: Array, z: Array, /) -> Array:
        a, b, c = (_folded(v, self.cell) ** 2 for v in (x, y, z))
        return np.sqrt(np.minimum(np.minimum(a + b, b + c), c + a)) - 0.5 * self.strut


@dataclass(frozen=True)
class OctetTruss(Distance):
    """Struts between nearest neighbors of a face-centered cubic lattice.

    Args:
        cell: Edge of the cube with a node at each corner and in the middle of each face [mm].
        strut: Diameter of a strut [mm].
    """

    cell: float = 3.0
    strut: float = 0.3

    def __post_init__(self) -> None:
        _thin(self, "strut", self.strut, sqrt(0.5) * self.cell)

    def __call__(self, x: Array, y: Array, z: Array, /) -> Array:
        point = [_folded(v, self.cell) for v in (x, y, z)]
        nearest = np.full(np.broadcast_shapes(*(p.shape for p in point)), np.inf)
        for a, b in combinations(self.cell * np.array(_TETRAHEDRON), 2):
            np.minimum(nearest, _segment(point, a, b), out=nearest)
        return np.sqrt(nearest) - 0.5 * self.strut


@dataclass(frozen=True)
class Pentamode(Distance):
    """A diamond lattice of double cones that meet in balls.

    Args:
        cell: Edge of the cubic diamond cell [mm].
        touch: Diameter of a ball [mm].
        middle: Diameter of a cone in the middle of a bond [mm].
    """

    cell: float = 3.2
    touch: float = 0.13
    middle: float = 0.6

    def __post_init__(self) -> None:
        _thin(self, "touch", self.touch, self.middle)
        _thin(self, "middle", self.middle, 0.25 * sqrt(3.0) * self.cell)

    def __call__(self, x: Array, y: Array, z: Array, /) -> Array:
        half = 0.125 * sqrt(3.0) * self.cell
        point = _about_atom(x, y, z, self.cell)
        apart = _dot(point, point)
        value = np.full(apart.shape, np.inf)
        for bond in np.array(_BONDS):
            along = _dot(point, bond / sqrt(3.0))
            across = np.sqrt(np.maximum(apart - along * along, 0.0))
            np.minimum(value, self._cone(np.abs(along - half), across, half), out=value)
            end = apart - 4.0 * half * along + 4.0 * half * half
            np.minimum(value, np.sqrt(np.maximum(end, 0.0)) - 0.5 * self.touch, out=value)
        return np.minimum(value, np.sqrt(apart) - 0.5 * self.touch)

    def _cone(self, along: Array, across: Array, half: float) -> Array:
        """Distance to a double cone, at ``along`` its axis from its middle and ``across`` the axis."""
        wide, narrow = 0.5 * self.middle, 0.5 * self.touch
        side = np.array([half, narrow - wide])
        t = np.clip((along * side[0] + (across - wide) * side[1]) / (side @ side), 0.0, 1.0)
        flank = (along - t * side[0]) ** 2 + (across - wide - t * side[1]) ** 2
        cap = (along - half) ** 2 + np.maximum(across - narrow, 0.0) ** 2
        inside = (along < half) & ((across - wide) * side[0] < along * side[1])
        return np.where(inside, -1.0, 1.0) * np.sqrt(np.minimum(flank, cap))


def _thin(shape: object, name: str, value: float, most: float) -> None:
    """`BadInput` unless 0 < value < most."""
    if positive(f"{type(shape).__name__} {name} [mm]", value) >= positive("cell [mm]", most):
        raise BadInput(
            f"{type(shape).__name__} {name} is {value:g} mm; expected less than {most:.4g} mm, or nothing stays open"
        )


def _folded(value: Array, cell: float) -> Array:
    """Distance to the nearest multiple of the cell."""
    value = np.asarray(value, np.float64)
    return np.abs(value - cell * np.round(value / cell))


def _segment(point: Sequence[Array], a: Array, b: Array) -> Array:
    """Squared distance to the segment from a to b."""
    way = b - a
    start = [p - s for p, s in zip(point, a, strict=True)]
    t = np.clip(_dot(start, way) / (way @ way), 0.0, 1.0)
    rest = [p - t * w for p, w in zip(start, way, strict=True)]
    return _dot(rest, rest)


def _dot(a: Any, b: Any) -> Array:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _about_atom(x: Array, y: Array, z: Array, cell: float) -> list[Array]:
    """Position relative to the nearest atom at (¼, ¼, ¼)·cell and its face-centered copies."""
    point = np.stack(np.broadcast_arrays(x, y, z)) / (0.5 * cell) - 0.5
    whole = np.round(point)
    rest = point - whole
    # Face centers have an even sum: if odd, the coordinate nearest to its rounding limit is rounded the other way.
    odd = whole.sum(axis=0) % 2 != 0
    axis = np.abs(rest).argmax(axis=0)
    turn = (np.arange(3).reshape(3, *(1,) * odd.ndim) == axis) & odd
    return list((rest - np.where(turn, np.where(rest < 0, -1.0, 1.0), 0.0)) * (0.5 * cell))

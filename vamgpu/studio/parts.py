"""Parts for the page: their extents, and a coarse mesh that is quick to make and to draw."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from math import ceil
from pathlib import Path
from typing import Any

import numpy as np

from vamgpu.errors import MeshError
from vamgpu.storage.memory import size
from vamgpu.storage.reading import read_bytes
from vamgpu.targets.mesh import read_mesh
from vamgpu.targets.stl import read_stl

MOST_BYTES = 1_000_000_000
"""Largest file of a part [bytes]."""
SHOWN = 120_000
"""Triangles of a mesh that the page draws, unless it asks for another number."""
MOST_CELLS = 1 << 24
"""Most cells of a clustering."""
FEW, DIRECTIONS = 20_000, 1000
"""Points up to which the hull is exact, and directions that replace it: 0.1 % of the size remain outside."""
SMALL, LARGE = 1.0, 300.0
"""Extents [mm] outside of which a file without a unit is probably not in mm."""
UNITLESS = (".stl", ".obj", ".ply")


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles as the page draws them. cell: edge of the clusters [mm]; 0 if all triangles are there."""

    positions: np.ndarray  # float32 (n, 3) [mm]
    indices: np.ndarray  # uint32 (m, 3)
    cell: float


@dataclass(frozen=True, eq=False)
class Part:
    """A part as its file has it."""

    name: str
    mesh: Mesh
    hull: np.ndarray  # float64 (n, 3): the corners of the mesh's convex hull [mm]
    ends: np.ndarray  # float64 (2, 3): lowest and highest corner of the file [mm]
    triangles: int
    notes: tuple[str, ...]

    @classmethod
    def load(cls, path: Path, most: int = SHOWN) -> Part:
        """Read a file without repairing it. Raises `MeshError`."""
        if path.suffix.lower() == ".stl":
            try:
                corners, notes = read_stl(read_bytes(path, MOST_BYTES), path.name)
            except OSError as error:
                raise MeshError(f"cannot read {path.name!r}: {error.strerror}; copy it again") from error
            points, faces = corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3)
        else:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                given, notes = read_mesh(path)
            points, faces = np.asarray(given.vertices, float), np.asarray(given.faces)
        columns = np.ascontiguousarray(points.T, np.float32)
        ends = np.full((2, 3), np.nan)
        if columns.size:
            ends[:] = [column.min() for column in columns], [column.max() for column in columns]
        if not len(faces) or not np.isfinite(ends).all():
            raise MeshError(f"{path.name!r} has no triangles, or corners that are not finite: export the part again")
        mesh = clustered(columns, faces, ends, most)
        return cls(path.name, mesh, _hull(mesh.positions), ends, len(faces), tuple(notes))

    def described(self) -> dict[str, Any]:
        """Extents of the part, and what is doubtful about its unit."""
        low, high = self.ends
        return {"triangles": self.triangles, "low": low.tolist(), "high": high.tolist(), "unit": "mm",
                "extents": (high - low).tolist(), "doubts": [*self._doubts(high - low), *self.notes]}  # fmt: skip

    def _doubts(self, extents: np.ndarray) -> list[str]:
        if Path(self.name).suffix.lower() not in UNITLESS:
            return []
        across, kind = float(extents.max()), Path(self.name).suffix[1:].upper()
        if across < SMALL:
            return [f"{kind} states no unit; read as mm the part is {across:.3g} mm in size: it may be in inches or m; "
                    "set target.height or target.factor"]  # fmt: skip
        if across > LARGE:
            return [f"{kind} states no unit; read as mm the part is {across:.3g} mm in size: it may be in µm; set "
                    "target.height or target.factor"]  # fmt: skip
        return []


def clustered(columns: np.ndarray, faces: np.ndarray, ends: np.ndarray, most: int) -> Mesh:
    """At most about ``most`` triangles: corners in the same cell of a grid become one of them."""
    # columns: float32 (3, n) [mm]; ends: lowest and highest corner [mm]
    if len(faces) <= most:
        used, places = np.unique(columns.T, axis=0, return_inverse=True)
        return Mesh(used, places.reshape(-1)[faces].astype(np.uint32), 0.0)
    some = np.ascontiguousarray(faces[:: len(faces) // FEW + 1])
    a, b, c = (columns[:, some[:, k]].T for k in range(3))
    area = 0.5 * float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()) * len(faces) / len(some)
    extent = np.maximum(ends[1] - ends[0], 1e-9)
    cell = max((3.0 * area / most) ** 0.5, (float(np.prod(extent + extent.max() / 1e3)) / MOST_CELLS) ** (1 / 3))
    while True:
        counts = [ceil(float(length) / cell) + 1 for length in extent]
        if counts[0] * counts[1] * counts[2] <= 2 * MOST_CELLS:
            found = _in_cells(columns, faces, ends[0], cell, counts)
            if len(found.indices) <= most:
                return found
        cell *= 1.25


def _in_cells(columns: np.ndarray, faces: np.ndarray, low: np.ndarray, cell: float, counts: list[int]) -> Mesh:
    """The mesh with one corner of those in each cell."""
    x, y, z = (((column - np.float32(least)) * np.float32(1.0 / cell)).astype(np.int32)
               for column, least in zip(columns, low, strict=True))  # fmt: skip
    cells = (x * counts[1] + y) * counts[2] + z
    corner = np.full(counts[0] * counts[1] * counts[2], -1, np.int32)
    corner[cells] = np.arange(len(cells), dtype=np.int32)
    used = np.flatnonzero(corner >= 0)
    place = np.zeros(len(corner), np.uint32)
    place[used] = np.arange(len(used), dtype=np.uint32)
    a, b, c = (place[cells[faces[:, k]]] for k in range(3))
    whole = (a != b) & (b != c) & (c != a)
    return Mesh(
        np.ascontiguousarray(columns[:, corner[used]].T), np.stack([a[whole], b[whole], c[whole]], axis=1), cell
    )


def _hull(points: np.ndarray) -> np.ndarray:
    """Corners of the convex hull; of many points, those that are farthest in each of `DIRECTIONS` directions."""
    from scipy.spatial import ConvexHull, QhullError

    points = points.astype(float)
    if len(points) > FEW:
        k = np.arange(DIRECTIONS) + 0.5
        z, turn = 1.0 - 2.0 * k / DIRECTIONS, np.pi * (1.0 + 5.0**0.5) * k
        ways = np.stack([np.sqrt(1.0 - z * z) * np.cos(turn), np.sqrt(1.0 - z * z) * np.sin(turn), z], axis=1)
        return points[np.unique(np.concatenate([(some @ points.T).argmax(axis=1) for some in np.split(ways, 20)]))]
    try:
        return points[ConvexHull(points).vertices]
    except QhullError:
        return np.unique(points, axis=0)


def placed(points: np.ndarray, hull: np.ndarray, target: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """Points and hull where a job places the part: rotated, scaled and centered as `Solid.placed` does it."""
    from vamgpu.targets.circle import smallest_enclosing_circle

    matrix = np.eye(3) if target.get("orientation") is None else np.asarray(target["orientation"], float)
    hull, points = hull @ matrix.T, points @ matrix.T
    high = float(np.ptp(hull[:, 2]))
    scale = target.get("factor") or (target["height"] / high if target.get("height") and high > 0.0 else 1.0)
    hull, points = hull * scale, points * scale
    x, y, _ = smallest_enclosing_circle(hull[:, :2])
    middle = np.array([x, y, 0.5 * (hull[:, 2].min() + hull[:, 2].max())])
    return points - middle, hull - middle


def too_large(count: int) -> str:
    """Message on a file that is too large."""
    return f"the part has {size(count)}; expected {size(MOST_BYTES)} at most: reduce its triangles"

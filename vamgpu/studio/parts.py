"""Parts for the page: their extents, and a coarse mesh that is quick to make and to draw."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from math import ceil
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from vamgpu.errors import MeshError
from vamgpu.scene.body import PRINTED
from vamgpu.storage.reading import read_bytes
from vamgpu.targets.mesh import parts_in, read_mesh
from vamgpu.targets.role_names import role_in
from vamgpu.targets.stl import read_stl

MOST_BYTES = 1_000_000_000  # largest file of a part [bytes]
SHOWN = 120_000  # largest number of triangles that the page draws, unless it asks for another one
MOST_CELLS = 1 << 24  # most cells of a clustering
FEW, DIRECTIONS = 20_000, 1000
"""Most points for an exact hull, and directions that replace it for more points: 0.1 % of the size remain outside."""
SMALL, LARGE = 1.0, 300.0  # extents [mm] outside of which a file without a unit is probably not in mm
OPEN = (
    "the surface has gaps: small ones are closed when the job is solved, larger ones are refused; close them in the CAD"
    " program"
)
SLAB = 1 << 16  # triangles that are checked at a time
MIXES = np.random.default_rng(1).integers(1, 1 << 63, (2, 3), np.uint64) | np.uint64(1)
"""Odd factors that combine a corner's coordinates into one number."""
UNITLESS = (".stl", ".obj", ".ply")


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles as the page draws them. cell: edge of the clusters [mm]; 0 if all triangles are there."""

    positions: np.ndarray  # float32 (n, 3) [mm]
    indices: np.ndarray  # uint32 (m, 3)
    owner: np.ndarray  # uint32 (m,): number of the solid of each triangle
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
    names: tuple[tuple[str, ...], ...] = ((),)  # of each solid, and of what contains it

    @classmethod
    def load(cls, path: Path, most: int = SHOWN) -> Part:
        """Read a file without repairing it. Raises `MeshError`."""
        if path.suffix.lower() == ".stl":
            try:
                corners, notes = read_stl(read_bytes(path, MOST_BYTES), path.name)
            except OSError as error:
                raise MeshError(f"cannot read {path.name!r}: {error.strerror}; copy it again") from error
            points, faces = corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3)
            solids: list[tuple[int, tuple[str, ...]]] = [(len(faces), ())]
        else:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                given, notes = read_mesh(path)
            points, faces = np.asarray(given.vertices, float), np.asarray(given.faces)
            solids = parts_in(given)
        columns = np.ascontiguousarray(points.T, np.float32)
        ends = np.full((2, 3), np.nan)
        if columns.size:
            ends[:] = [column.min() for column in columns], [column.max() for column in columns]
        if not len(faces) or not np.isfinite(ends).all():
            raise MeshError(f"{path.name!r} has no triangles, or corners that are not finite: export the part again")
        owner = np.repeat(np.arange(len(solids), dtype=np.uint32), [count for count, _ in solids])
        mesh = clustered(columns, faces, owner, ends, most)
        notes = (*notes, *(() if is_closed(columns, faces) else (OPEN,)))
        names = tuple(each for _, each in solids)
        return cls(path.name, mesh, _hull(mesh.positions), ends, len(faces), notes, names)

    @property
    def solids(self) -> int:
        """Number of solids of the file."""
        return len(self.names)

    @property
    def bodies(self) -> list[dict[str, str | None]]:
        """Name of each solid, and the role that its names begin with."""
        return [{"name": next(iter(names), None), "role": role_in(names)} for names in self.names]

    def only(self, number: int) -> Part:
        """One of the solids of a file, from 1."""
        mine = self.mesh.owner == number - 1
        used, places = np.unique(self.mesh.indices[mine], return_inverse=True)
        points = self.mesh.positions[used]
        if not len(points):
            raise MeshError(f"{self.name!r} has {self.solids} parts; expected part 1 to {self.solids}, not {number}")
        mesh = Mesh(points, places.reshape(-1, 3).astype(np.uint32), self.mesh.owner[mine], self.mesh.cell)
        ends = np.stack([points.min(axis=0), points.max(axis=0)]).astype(float)
        return Part(self.name, mesh, _hull(points), ends, int(mine.sum()), self.notes)

    def described(self) -> dict[str, Any]:
        """Extents of the part, and whether its unit is in doubt."""
        low, high = self.ends
        return {"triangles": self.triangles, "bodies": self.bodies, "unit": "mm", "low": low.tolist(),
                "high": high.tolist(), "extents": (high - low).tolist(),
                "doubts": [*self._doubts(high - low), *self.notes]}  # fmt: skip

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


def is_closed(columns: np.ndarray, faces: np.ndarray) -> bool:
    """Whether every edge has a neighbor that runs the other way, by sums in which such edges cancel exactly."""
    # For random whole numbers f, g of the corners, f(a) g(b) − f(b) g(a) changes its sign with the edge's direction.
    total = 0
    x, y, z = (np.ascontiguousarray(column + np.float32(0.0), np.float32).view(np.uint32) for column in columns)
    for first in range(0, len(faces), SLAB):
        some = faces[first : first + SLAB].ravel()
        f, g = (_mixed(x[some], y[some], z[some], factors).reshape(-1, 3) for factors in MIXES)
        for k, after in ((0, 1), (1, 2), (2, 0)):
            total += int(np.sum(f[:, k] * g[:, after] - f[:, after] * g[:, k], dtype=np.uint64))
    return total % 2**64 == 0


def _mixed(x: np.ndarray, y: np.ndarray, z: np.ndarray, factors: np.ndarray) -> np.ndarray:
    """A whole number for each corner that depends on every bit of its coordinates."""
    found = x * factors[0]
    found += y * factors[1]
    found += z * factors[2]
    found ^= found >> np.uint64(29)
    found *= factors[0]
    return found


def clustered(columns: np.ndarray, faces: np.ndarray, owner: np.ndarray, ends: np.ndarray, most: int) -> Mesh:
    """At most about ``most`` triangles: corners in the same cell of a grid become one of them."""
    # columns: float32 (3, n) [mm]; ends: lowest and highest corner [mm]
    if len(faces) <= most:
        used, places = np.unique(columns.T, axis=0, return_inverse=True)
        return Mesh(used, places.reshape(-1)[faces].astype(np.uint32), owner, 0.0)
    some = np.ascontiguousarray(faces[:: len(faces) // FEW + 1])
    a, b, c = (columns[:, some[:, k]].T for k in range(3))
    area = 0.5 * float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()) * len(faces) / len(some)
    extent = np.maximum(ends[1] - ends[0], 1e-9)
    cell = max((3.0 * area / most) ** 0.5, (float(np.prod(extent + extent.max() / 1e3)) / MOST_CELLS) ** (1 / 3))
    while True:
        counts = [ceil(float(length) / cell) + 1 for length in extent]
        if counts[0] * counts[1] * counts[2] <= 2 * MOST_CELLS:
            found = _in_cells(columns, faces, owner, ends[0], cell, counts)
            if len(found.indices) <= most:
                return found
        cell *= 1.25


def _in_cells(
    columns: np.ndarray, faces: np.ndarray, owner: np.ndarray, low: np.ndarray, cell: float, counts: list[int]
) -> Mesh:
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
    positions = np.ascontiguousarray(columns[:, corner[used]].T)
    return Mesh(positions, np.stack([a[whole], b[whole], c[whole]], axis=1), owner[whole], cell)


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

    matrix = _matrix(target)
    hull, points = hull @ matrix.T, points @ matrix.T
    high = float(np.ptp(hull[:, 2]))
    scale = target.get("factor") or (target["height"] / high if target.get("height") and high > 0.0 else 1.0)
    hull, points = hull * scale, points * scale
    x, y, _ = smallest_enclosing_circle(hull[:, :2])
    middle = np.array([x, y, 0.5 * (hull[:, 2].min() + hull[:, 2].max())])
    return points - middle, hull - middle


class Drawn(NamedTuple):
    """The bodies of a job where it places them; the hull is that of what is printed."""

    positions: np.ndarray  # float32 (n, 3) [mm]
    mesh: Mesh
    hull: np.ndarray  # float64 (n, 3) [mm]
    triangles: int
    doubts: list[str]
    bodies: list[dict[str, Any]]  # number of its table in the job, name, role


def drawn(part: Part, target: Mapping[str, Any]) -> Drawn:
    """One part where a job places it."""
    points, hull = placed(part.mesh.positions.astype(float), part.hull, target)
    return Drawn(points.astype(np.float32), part.mesh, hull, part.triangles, part.described()["doubts"], [])


def drawn_bodies(parts: list[Part], bodies: list[dict[str, Any]], target: Mapping[str, Any]) -> Drawn:
    """Bodies where a job places them: turned and scaled about the origin; by default, centered along z."""
    matrix = _matrix(target) * (target.get("factor") or 1.0)
    origin = target.get("origin")
    away = np.zeros(3) if origin is None else matrix @ np.asarray(origin, float)
    hulls = [part.hull @ matrix.T - away for part in parts]
    lit = np.concatenate([hull for hull, body in zip(hulls, bodies, strict=True) if body["role"] in PRINTED] or hulls)
    if origin is None:
        away = np.array([0.0, 0.0, 0.5 * (lit[:, 2].min() + lit[:, 2].max())])
        lit = lit - away
    starts = np.cumsum([0, *(len(part.mesh.positions) for part in parts)])
    points = np.concatenate([part.mesh.positions.astype(float) for part in parts]) @ matrix.T - away
    faces = np.concatenate([part.mesh.indices + np.uint32(start) for part, start in zip(parts, starts, strict=False)])
    owner = np.concatenate([np.full(len(part.mesh.indices), k, np.uint32) for k, part in enumerate(parts)])
    mesh = Mesh(points.astype(np.float32), faces, owner, max(part.mesh.cell for part in parts))
    doubts = [doubt for part in parts for doubt in part.described()["doubts"]]
    return Drawn(mesh.positions, mesh, lit, sum(part.triangles for part in parts), list(dict.fromkeys(doubts)), bodies)


def _matrix(target: Mapping[str, Any]) -> np.ndarray:
    return np.eye(3) if target.get("orientation") is None else np.asarray(target["orientation"], float)

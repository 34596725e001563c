"""A closed triangle surface, from which every target starts."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from vamgpu.errors import BadInput, EmptyMesh, MeshError
from vamgpu.storage.atomic import replacing
from vamgpu.targets.circle import smallest_enclosing_circle

if TYPE_CHECKING:
    import trimesh


@dataclass(frozen=True, eq=False)
class Solid:
    """A triangle surface in mm; faces that point outward are counter-clockwise seen from outside.

    vertices: float64 (n, 3) [mm]; faces: int32 (m, 3), indices into vertices. Both are kept as read-only copies.
    The vial's axis is x = y = 0, along z. mended: changes made by a repair, one sentence each; empty for a sound mesh.
    drawn: whether the solid stays where it was drawn about the axis, as with ``center=False``.

    Raises EmptyMesh without faces, MeshError for wrong shapes, indices out of range or coordinates that are not finite.
    """

    vertices: npt.NDArray[np.float64]
    faces: npt.NDArray[np.int32]
    name: str = "solid"
    mended: tuple[str, ...] = ()
    drawn: bool = False

    def __post_init__(self) -> None:
        vertices = np.array(self.vertices, dtype=np.float64, order="C")
        faces = np.asarray(self.faces)
        if faces.size == 0 or vertices.size == 0:
            raise EmptyMesh(f"{self.name}: the mesh has no triangles; export the part again as a triangle mesh")
        if vertices.ndim != 2 or vertices.shape[1] != 3 or faces.ndim != 2 or faces.shape[1] != 3:
            raise MeshError(
                f"{self.name}: vertices {vertices.shape} and faces {faces.shape}; expected (n, 3) and (m, 3) triangles"
            )
        if not np.isfinite(vertices).all():
            raise MeshError(f"{self.name}: a vertex is NaN or infinite; export the mesh again")
        if faces.min() < 0 or faces.max() >= len(vertices):
            raise MeshError(
                f"{self.name}: faces refer to vertices {faces.min()}..{faces.max()}, but there are {len(vertices)}"
            )
        faces = np.array(faces, dtype=np.int32, order="C")
        for field, value in (("vertices", vertices), ("faces", faces)):
            value.setflags(write=False)
            object.__setattr__(self, field, value)

    @property
    def volume(self) -> float:
        """Enclosed volume [mm3], by the divergence theorem; meaningful if the surface is watertight."""
        a, b, c = np.moveaxis((self.vertices - self.vertices.mean(axis=0))[self.faces], 1, 0)
        return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)

    @property
    def bounds(self) -> npt.NDArray[np.float64]:
        """Lowest and highest corner [mm], shape (2, 3)."""
        used = self.vertices[np.unique(self.faces)]
        return np.stack([used.min(axis=0), used.max(axis=0)])

    @property
    def height(self) -> float:
        """Extent along z [mm]."""
        low, high = self.bounds
        return float(high[2] - low[2])

    @property
    def radius(self) -> float:
        """Largest distance from the axis x = y = 0 [mm]."""
        used = self.vertices[np.unique(self.faces)]
        return float(np.hypot(used[:, 0], used[:, 1]).max())

    @property
    def open_edges(self) -> int:
        """Number of edges along which the surface does not close (0 = watertight and consistently wound)."""
        return len(unmatched_edges(self.faces))

    def rotated(self, rotation: npt.ArrayLike) -> Solid:
        """Rotate by a 3 x 3 rotation matrix R, vertex -> R @ vertex. Raises BadInput if R is not a proper rotation."""
        matrix = np.asarray(rotation, dtype=np.float64)
        if matrix.shape != (3, 3):
            raise BadInput(f"rotation has shape {matrix.shape}; expected a 3 x 3 matrix")
        # Hand-typed matrices have about six digits; a NaN also fails this test.
        if not np.allclose(matrix @ matrix.T, np.eye(3), rtol=0.0, atol=1e-5):
            raise BadInput("rotation is not orthogonal (R @ R.T differs from 1 by more than 1e-5); scale with factor=")
        if np.linalg.det(matrix) < 0.0:
            raise BadInput(
                "rotation has determinant -1 and would mirror the part; expected +1: flip the sign of one row"
            )
        return replace(self, vertices=self.vertices @ matrix.T)

    def scaled(self, factor: float) -> Solid:
        """Multiply all lengths by factor > 0. Raises BadInput for other factors."""
        if not (np.isfinite(factor) and factor > 0.0):
            raise BadInput(f"factor is {factor}; expected a positive number")
        return replace(self, vertices=self.vertices * float(factor))

    def translated(self, shift: npt.ArrayLike) -> Solid:
        """Move by shift = (x, y, z) [mm]. Raises BadInput if shift is not three finite numbers."""
        move = np.asarray(shift, dtype=np.float64)
        if move.shape != (3,) or not np.isfinite(move).all():
            raise BadInput(f"shift is {shift}; expected three finite lengths [mm]")
        return replace(self, vertices=self.vertices + move)

    def leveled(self) -> Solid:
        """Put mid-height at z = 0."""
        low, high = self.bounds
        return self.translated((0.0, 0.0, -0.5 * (low[2] + high[2])))

    def centered(self) -> Solid:
        """Put the smallest enclosing circle of the footprint on the axis and mid-height at z = 0."""
        x, y, _ = smallest_enclosing_circle(self.vertices[np.unique(self.faces), :2])
        return self.translated((-x, -y, 0.0)).leveled()

    def placed(
        self,
        *,
        rotation: npt.ArrayLike | None = None,
        height: float | None = None,
        factor: float | None = None,
        center: bool = True,
    ) -> Solid:
        """Rotate, then scale (to height [mm] along z, or by factor), then center."""
        solid = self if rotation is None else self.rotated(rotation)
        if height is not None and factor is not None:
            raise BadInput(f"got height={height} and factor={factor}; give one of them")
        if height is not None:
            if not (np.isfinite(height) and height > 0.0):
                raise BadInput(f"height is {height}; expected a positive length [mm]")
            if solid.height == 0.0:
                raise MeshError(f"{self.name}: the mesh is flat along z and cannot be scaled to a height; use factor=")
            factor = height / solid.height
        if factor is not None:
            solid = solid.scaled(factor)
        return solid.centered() if center else solid

    def to_mesh(self) -> trimesh.Trimesh:
        """Return a trimesh.Trimesh with the same vertices and faces (writable copies)."""
        import trimesh

        return trimesh.Trimesh(self.vertices.copy(), self.faces.copy(), process=False, metadata={"name": self.name})

    def save(self, path: str | Path) -> Path:
        """Write STL, PLY, OBJ or 3MF, by the suffix of path, and return the path."""
        file = Path(path)
        if file.suffix.lower() not in {".stl", ".ply", ".obj", ".3mf"}:
            raise BadInput(f"cannot write {file.name!r}: expected a name ending in .stl, .ply, .obj or .3mf")
        mesh = self.to_mesh()
        mesh.units = "millimeter"
        data = mesh.export(file_type=file.suffix.lower()[1:])
        with replacing(file, overwrite=True) as draft:  # a full disk then leaves no half-written mesh
            draft.write_bytes(data.encode() if isinstance(data, str) else bytes(data))
        return file


def unmatched_edges(faces: npt.NDArray[np.integer]) -> npt.NDArray[np.int64]:
    """Directed edges (k, 2) not traversed equally often in both directions, one row per undirected edge."""
    directed = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64)
    directed = directed[directed[:, 0] != directed[:, 1]]
    if len(directed) == 0:
        return directed
    low, high = directed.min(axis=1), directed.max(axis=1)
    keys, where = np.unique(low * (int(high.max()) + 1) + high, return_inverse=True)
    net = np.bincount(where, weights=np.where(directed[:, 0] == low, 1.0, -1.0), minlength=len(keys))
    first = np.full(len(keys), -1, dtype=np.int64)
    # Return the direction that occurs more often: hole filling runs against it.
    excess = np.where(directed[:, 0] == low, 1.0, -1.0) * net[where] > 0
    first[where[excess]] = np.flatnonzero(excess)
    return directed[first[first >= 0]]

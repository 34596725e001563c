"""The nearest point of a triangle surface, exactly, and the side of the surface on which a point lies."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from vamgpu.errors import BadInput
from vamgpu.metrics.triangle_search import Array, TriangleSearch, barycentric
from vamgpu.schema.quantities import numeric
from vamgpu.targets.repair import repaired
from vamgpu.targets.solid import Solid

__all__ = ["Array", "NearestPoints", "Nearest", "as_points", "barycentric", "nearest"]

Indices = npt.NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class NearestPoints:
    """The nearest points of a surface. point: (n, 3) [mm]. normal: (n, 3), outward, of the face."""

    point: Array
    normal: Array
    distance: Array  # (n,) [mm], > 0 outside, < 0 inside


class Nearest:
    """Search over a closed surface; build it once and query it often."""

    # Sides follow angle-weighted normals at corners and edges, which are right for every closed surface (J. A.
    # Bærentzen and H. Aanæs, Signed distance computation using the angle weighted pseudonormal, IEEE TVCG 11 (2005)
    # 243). longest: see `TriangleSearch`.
    # search: its triangles that have an area.

    normals: Array  # outward unit normal of each of those

    def __init__(self, solid: Solid, longest: float = 0.0) -> None:
        self.solid: Solid = repaired(solid)
        self.search: TriangleSearch = TriangleSearch(self.solid.vertices[self.solid.faces], longest)
        self._faces, self._corners = self.solid.faces[self.search.kept], self.search.corners
        self.normals, self._edge_normal, self._vertex_normal = _normals(self._faces, self._corners)

    def __call__(self, points: npt.ArrayLike, *, exact: bool = True, most: int | None = None) -> NearestPoints:
        """Nearest points of the surface for points (n, 3) [mm]. Raises `BadInput`."""
        # exact: False searches only a few triangles in each point's neighborhood, which is faster and almost right.
        # most: greatest number of pieces of triangles searched for one point; see `TriangleSearch`.
        asked = as_points(points)
        best, weight, face = self.search(asked, exact=exact, most=most)
        point = np.einsum("nk,nki->ni", weight, self._corners[face])
        side = np.einsum("ni,ni->n", asked - point, self._pseudo(face, weight))
        return NearestPoints(point, self.normals[face], np.where(side < 0, -best, best))

    def _pseudo(self, face: Indices, weight: Array) -> Array:
        """Normal of the face, edge or corner that contains a nearest point."""
        zeros = weight == 0.0
        count = zeros.sum(axis=1)
        normal = self.normals[face].copy()
        edge, corner = count == 1, count == 2
        normal[edge] = self._edge_normal[face[edge], zeros[edge].argmax(axis=1)]
        normal[corner] = self._vertex_normal[self._faces[face[corner], (~zeros[corner]).argmax(axis=1)]]
        return normal


@lru_cache(maxsize=1)
def nearest(solid: Solid, longest: float) -> Nearest:
    """The search over a solid, which a report asks for twice: for thin regions, and for distances."""
    return Nearest(solid, longest)


def as_points(points: npt.ArrayLike) -> Array:
    """Points as float64 (n, 3), n ≥ 1, or `BadInput`."""
    array = numeric("points", points, (2,), "finite coordinates (n, 3) [mm]: drop points that are not")
    if array.shape[1] != 3:
        raise BadInput(f"points have shape {array.shape}; expected (n, 3) with n ≥ 1 [mm]")
    return array


def _normals(faces: npt.NDArray[np.int32], corners: Array) -> tuple[Array, Array, Array]:
    """Unit normals of faces (m, 3), sums of them over each edge (m, 3 opposite corners, 3), by angle over vertices."""
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flat /= np.linalg.norm(flat, axis=1)[:, None]
    ends = np.sort(faces[:, [1, 2, 2, 0, 0, 1]].reshape(-1, 3, 2), axis=2).astype(np.int64)
    _, which = np.unique(ends[..., 0] * (int(faces.max()) + 1) + ends[..., 1], return_inverse=True)
    which = which.reshape(-1, 3)
    edges, vertices = np.zeros((int(which.max()) + 1, 3)), np.zeros((int(faces.max()) + 1, 3))
    for k in range(3):
        edges += _summed(which[:, k], flat, len(edges))
        one, other = (corners[:, (k + j) % 3] - corners[:, k] for j in (1, 2))
        turn = np.arctan2(np.linalg.norm(np.cross(one, other), axis=1), np.einsum("ni,ni->n", one, other))
        vertices += _summed(faces[:, k], turn[:, None] * flat, len(vertices))
    return flat, edges[which], vertices


def _summed(where: npt.NDArray[np.integer], vectors: Array, number: int) -> Array:
    """Sums (number, 3) of the vectors (n, 3) that go to each place."""
    return np.stack([np.bincount(where, part, number).astype(np.float64) for part in vectors.T], axis=1)

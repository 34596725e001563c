"""The nearest point of a triangle surface, exactly, and on which side of the surface a point lies."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from vamgpu.errors import BadInput
from vamgpu.targets.repair import repaired
from vamgpu.targets.solid import Solid

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

_FIRST, _GROWTH = 8, 4
"""Triangles looked at for a point, and how many times as many where a nearer one cannot be ruled out yet."""
_BATCH = 1 << 18
"""Pairs of a point and a triangle held in memory at once."""
_PARTS = 100
"""Triangles are searched in pieces whose edges are no longer than this part of the box diagonal."""


@dataclass(frozen=True, eq=False)
class Found:
    """The nearest points of a surface. point: (n, 3) [mm].  normal: (n, 3), outward, of the face.

    distance: (n,) [mm], > 0 outside, < 0 inside.
    """

    point: Array
    normal: Array
    distance: Array


class Nearest:
    """Search over a closed surface; build once, ask often.

    Sides follow angle-weighted normals at corners and edges, which are right for every closed surface (J. A. Bærentzen
    and H. Aanæs, Signed distance computation using the angle weighted pseudonormal, IEEE TVCG 11 (2005) 243).
    Raises `NotWatertight` and what repairing a mesh raises.
    """

    def __init__(self, solid: Solid) -> None:
        from scipy.spatial import KDTree

        self.solid = repaired(solid)
        corners = self.solid.vertices[self.solid.faces]
        kept = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) > 0
        self._faces, self._corners = self.solid.faces[kept], corners[kept]
        self._face_normal, self._edge_normal, self._vertex_normal = _normals(self._faces, self._corners)
        middles, self._parent, self._reach = _pieces(self._corners, self._faces, self.solid.vertices)
        self._tree = KDTree(middles)

    def __call__(self, points: npt.ArrayLike, *, exact: bool = True) -> Found:
        """Nearest points of the surface for points (n, 3) [mm]. Raises `BadInput`.

        exact: False looks at a few triangles of each point's neighborhood only, which is faster and almost right.
        """
        asked = as_points(points)
        best, weight, face = self._search(asked, exact)
        point = np.einsum("nk,nki->ni", weight, self._corners[face])
        side = np.einsum("ni,ni->n", asked - point, self._pseudo(face, weight))
        return Found(point, self._face_normal[face], np.where(side < 0, -best, best))

    def _search(self, points: Array, exact: bool) -> tuple[Array, Array, Indices]:
        """Distance, barycentric weights and face of the nearest point."""
        best, weight = np.full(len(points), np.inf), np.zeros((len(points), 3))
        face = np.zeros(len(points), np.int64)
        open_points, count = np.arange(len(points)), _FIRST
        while open_points.size:
            count = min(count, len(self._parent))
            sure = np.zeros(open_points.size, bool)
            step = max(1, _BATCH // count)
            nearest: Any = np.arange(1, count + 1)
            for first in range(0, open_points.size, step):
                chosen = open_points[first : first + step]
                far, piece = self._tree.query(points[chosen], k=nearest)
                distance, found, which = self._closest(points[chosen], self._parent[piece])
                best[chosen], weight[chosen], face[chosen] = distance, found, which
                sure[first : first + step] = far[:, -1] - self._reach >= distance
            if count == len(self._parent) or not exact:
                break
            open_points, count = open_points[~sure], count * _GROWTH
        return best, weight, face

    def _closest(self, points: Array, faces: Indices) -> tuple[Array, Array, Indices]:
        """The nearest of some faces (n, k) to each point."""
        n, k = faces.shape
        corners = self._corners[faces.ravel()]
        weight = barycentric(np.repeat(points, k, axis=0), corners)
        foot = np.einsum("nk,nki->ni", weight, corners)
        apart = np.linalg.norm(np.repeat(points, k, axis=0) - foot, axis=1).reshape(n, k)
        at = apart.argmin(axis=1)
        row = np.arange(n)
        return apart[row, at], weight.reshape(n, k, 3)[row, at], faces[row, at]

    def _pseudo(self, face: Indices, weight: Array) -> Array:
        """Normal of the face, edge or corner that a nearest point lies on."""
        zeros = weight == 0.0
        count = zeros.sum(axis=1)
        normal = self._face_normal[face].copy()
        edge, corner = count == 1, count == 2
        normal[edge] = self._edge_normal[face[edge], zeros[edge].argmax(axis=1)]
        normal[corner] = self._vertex_normal[self._faces[face[corner], (~zeros[corner]).argmax(axis=1)]]
        return normal


def as_points(points: npt.ArrayLike) -> Array:
    """Points as float64 (n, 3), n ≥ 1, or `BadInput`."""
    array = np.asarray(points, np.float64)
    if array.ndim != 2 or array.shape[1:] != (3,) or not len(array):
        raise BadInput(f"points have shape {array.shape}; wanted (n, 3) with n ≥ 1 [mm]")
    if not np.isfinite(array).all():
        raise BadInput(f"{np.count_nonzero(~np.isfinite(array).all(axis=1))} points are NaN or infinite; drop them")
    return array


def barycentric(points: Array, corners: Array) -> Array:
    """Weights (n, 3) of the corners (n, 3, 3) of each triangle that make its point nearest to each point (n, 3).

    On an edge one weight, at a corner two are exactly 0.
    """
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    normal = np.cross(b - a, c - a)
    area = np.einsum("ni,ni->n", normal, normal)
    weight = np.stack([np.einsum("ni,ni->n", np.cross(q - p, points - p), normal) / area
                       for p, q in ((b, c), (c, a), (a, b))], axis=1)  # fmt: skip
    outside = np.flatnonzero((weight <= 0).any(axis=1))
    best = np.full(outside.size, np.inf)
    for k in range(3):  # the edge opposite to corner k
        p, q = corners[outside, (k + 1) % 3], corners[outside, (k + 2) % 3]
        way, start = q - p, points[outside] - p
        t = np.clip(np.einsum("ni,ni->n", start, way) / np.einsum("ni,ni->n", way, way), 0.0, 1.0)
        apart = ((start - t[:, None] * way) ** 2).sum(axis=1)
        nearer = apart < best
        best[nearer] = apart[nearer]
        row = outside[nearer]
        weight[row, k], weight[row, (k + 1) % 3], weight[row, (k + 2) % 3] = 0.0, 1.0 - t[nearer], t[nearer]
    return weight


def _normals(faces: npt.NDArray[np.int32], corners: Array) -> tuple[Array, Array, Array]:
    """Unit normals of faces (m, 3), sums of them over each edge (m, 3 opposite corners, 3), by angle over vertices."""
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flat /= np.linalg.norm(flat, axis=1)[:, None]
    ends = np.sort(faces[:, [1, 2, 2, 0, 0, 1]].reshape(-1, 3, 2), axis=2).astype(np.int64)
    _, which = np.unique(ends[..., 0] * (int(faces.max()) + 1) + ends[..., 1], return_inverse=True)
    which = which.reshape(-1, 3)
    edges, vertices = np.zeros((int(which.max()) + 1, 3)), np.zeros((int(faces.max()) + 1, 3))
    for k in range(3):
        np.add.at(edges, which[:, k], flat)
        one, other = (corners[:, (k + j) % 3] - corners[:, k] for j in (1, 2))
        turn = np.arctan2(np.linalg.norm(np.cross(one, other), axis=1), np.einsum("ni,ni->n", one, other))
        np.add.at(vertices, faces[:, k], turn[:, None] * flat)
    return flat, edges[which], vertices


def _pieces(corners: Array, faces: npt.NDArray[np.int32], vertices: Array) -> tuple[Array, Indices, float]:
    """Middles of pieces of the triangles, the triangle of each, and the farthest any reaches from its middle."""
    from trimesh.remesh import subdivide_to_size

    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    limit = max(2.0 * float(np.median(edges)), float(np.linalg.norm(np.ptp(vertices, axis=0))) / _PARTS)
    parent = np.arange(len(faces))
    if edges.max() > limit:
        found: Any = subdivide_to_size(vertices, faces, limit, max_iter=30, return_index=True)
        corners, parent = found[0][found[1]], found[2]
    middles = corners.mean(axis=1)
    return middles, np.asarray(parent, np.int64), float(np.linalg.norm(corners - middles[:, None], axis=2).max())

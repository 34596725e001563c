"""Thickness of a part's walls, and width of the gaps between them, at points of its surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vamgpu.metrics.triangle_search import Array, TriangleSearch

FACING = 0.5  # smallest cosine between a wall's direction of thickness and the normal of its far side: 60° at most
_RAYS = 1000  # number of rays processed at a time
_RIM = 1e-9  # share of a triangle by which a ray may miss it; no ray then slips through between two triangles


@dataclass(frozen=True, eq=False)
class Walls:
    """The wall below each of some points of a part's surface."""

    # (n,) whether the part ends below the point, within the searched thickness, at a side that faces it
    is_wall: npt.NDArray[np.bool_]
    thickness: Array  # (n,) [mm] along the normal; infinite where there is no wall
    center: Array  # (n, 3) [mm] halfway through the wall; the point itself where there is none


def walls(surface: TriangleSearch, points: Array, normals: Array, widest: float, gaps: bool = False) -> Walls:
    """Thickness of a part along the inward normals of its surface, or the width of its gaps along the outward ones."""
    # It is the shape diameter (L. Shapira, A. Shamir and D. Cohen-Or, Vis. Comput. 24 (2008) 249), measured by one ray.
    # A ball instead of a ray would see a square pin as a corner, because it touches neighboring sides first. points (n,
    # 3) [mm]; normals (n, 3); widest [mm]
    thickness, facing = np.full(len(points), np.inf), np.zeros(len(points))
    if gaps:
        normals = -normals
    for first in range(0, len(points), _RAYS):
        some = slice(first, first + _RAYS)
        ray, face = surface.near_segments(points[some], points[some] - widest * normals[some])
        start, along = points[some][ray], -normals[some][ray]
        length, cosine = _exits(start, along, surface.corners[face][:, :: -1 if gaps else 1])
        order = np.argsort(-length, kind="stable")  # the shortest is written last
        order = order[length[order] <= widest]
        thickness[some][ray[order]] = length[order]
        facing[some][ray[order]] = cosine[order]
    is_wall = facing >= FACING
    thickness = np.where(is_wall, thickness, np.inf)
    return Walls(is_wall, thickness, points - 0.5 * np.where(is_wall, thickness, 0.0)[:, None] * normals)


def _exits(start: Array, along: Array, corners: Array) -> tuple[Array, Array]:
    """Length at which each ray leaves through its triangle, else infinite, and its cosine to the normal."""
    # By T. Möller and B. Trumbore, J. Graphics Tools 2 (1997) 21.
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(one, other)
    depth = np.einsum("ij,ij->i", along, normal)
    leaves = depth > 0
    safe = np.where(leaves, depth, 1.0)
    offset = corners[:, 0] - start
    length = np.einsum("ij,ij->i", offset, normal) / safe
    turn = np.cross(offset, along)
    u = np.einsum("ij,ij->i", other, turn) / safe
    v = -np.einsum("ij,ij->i", one, turn) / safe
    hit = leaves & (length > 0) & (u >= -_RIM) & (v >= -_RIM) & (u + v <= 1.0 + _RIM)
    return np.where(hit, length, np.inf), depth / np.maximum(np.linalg.norm(normal, axis=1), 1e-300)

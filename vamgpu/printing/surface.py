"""Surfaces of a target and of its print, small enough to be looked at in a browser."""

from __future__ import annotations

import base64
import zlib
from dataclasses import dataclass
from math import ceil
from typing import Any

import numpy as np

LARGEST = 128
"""Fields with longer edges [voxels] are averaged in blocks first."""


@dataclass(frozen=True, eq=False)
class Surface:
    """Triangles of one surface. points: (n, 3) [mm].  normals: (n, 3).  faces: (m, 3)."""

    points: np.ndarray
    normals: np.ndarray
    faces: np.ndarray

    def packed(self, deviation: np.ndarray, reach: float) -> dict[str, str]:
        """Deflated base64 of 16-bit points over ±reach [mm], 8-bit normals, 8-bit deviation over ±1, 32-bit faces.

        Points and faces are kept as steps from one to the next, which deflate much better.
        """
        points = np.round(np.clip(self.points / reach, -1, 1) * 32767).astype("<i2")
        normals = np.round(self.normals * 127).astype("i1")
        shade = np.round(np.clip(deviation, -1, 1) * 127).astype("i1")
        arrays = {
            "points": np.diff(points, axis=0, prepend=np.zeros((1, 3), "<i2")),
            "normals": normals,
            "shade": shade,
            "faces": np.diff(self.faces.ravel().astype("<i4"), prepend=np.zeros(1, "<i4")),
        }
        return {name: base64.b64encode(zlib.compress(a.tobytes(), 9)).decode() for name, a in arrays.items()}


NOTHING = Surface(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3), np.uint32))


def iso_surface(field: np.ndarray, level: float, pitch: float) -> Surface:
    """Where a field [x, y, z] crosses ``level``, closed at its edges; coordinates [mm] from the middle of the grid."""
    from skimage.measure import marching_cubes

    block = max(1, ceil(max(field.shape) / LARGEST))
    coarse = np.pad(block_mean(field, block), 1)
    if not coarse.max() > level or not coarse.min() < level:
        return NOTHING
    points, faces, _, _ = marching_cubes(coarse, level, gradient_direction="ascent")
    edge = np.array([ceil(n / block) * block for n in field.shape]) - np.array(field.shape)
    middle = (np.array(coarse.shape) - 1) / 2 - edge / (2 * block)
    return Surface((points - middle) * (block * pitch), vertex_normals(points, faces), faces)


def vertex_normals(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Mean of the normals of the triangles around each point, by area; (n, 3), smoother than the field's gradient."""
    a, b, c = (points[faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    total = np.stack([np.bincount(faces.ravel(), np.repeat(part, 3), len(points)) for part in normal.T], axis=1)
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12)


def block_mean(field: np.ndarray, block: int) -> np.ndarray:
    """Means of cubes of ``block`` voxels; what is missing at the far edges counts as zero."""
    if block == 1:
        return field
    padded = np.pad(field, [(0, -n % block) for n in field.shape])
    nx, ny, nz = (n // block for n in padded.shape)
    return padded.reshape(nx, block, ny, block, nz, block).mean(axis=(1, 3, 5))


def deviation(printed: Surface, target: Surface) -> np.ndarray:
    """Signed distance [mm] of each printed point from the target's nearest tangent plane, outwards positive; (n,)."""
    if not len(printed.points) or not len(target.points):
        return np.zeros(len(printed.points))
    from scipy.spatial import KDTree

    _, nearest = KDTree(target.points).query(printed.points)
    return np.einsum("ij,ij->i", printed.points - target.points[nearest], target.normals[nearest])


def viewer(target: Surface, printed: Surface, most: float) -> dict[str, Any]:
    """Both surfaces as the page's script takes them; ``most`` is the deviation [mm] at the ends of the color scale."""
    points = np.concatenate([target.points, printed.points])
    reach = float(np.abs(points).max(initial=most))
    return {
        "target": target.packed(np.zeros(len(target.points)), reach),
        "printed": printed.packed(deviation(printed, target) / most, reach),
        "radius": 2 * float(np.linalg.norm(points, axis=1).max(initial=most)) / reach,
    }

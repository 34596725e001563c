"""Surfaces of a target and of its print, small enough to view in a browser."""

from __future__ import annotations

import base64
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil
from typing import TYPE_CHECKING, Any

import numpy as np

from vamgpu.backend.cores import threads

if TYPE_CHECKING:
    from vamgpu.printing.proof import Proof

LARGEST = 128  # fields with more voxels along an edge are first averaged in blocks


@dataclass(frozen=True, eq=False)
class Surface:
    """Triangles of one surface. points: (n, 3) [mm].  normals: (n, 3).  faces: (m, 3)."""

    points: np.ndarray
    normals: np.ndarray
    faces: np.ndarray

    def packed(self, deviation: np.ndarray, reach: float) -> dict[str, str]:
        """Deflated base64 of 16-bit points over ±reach [mm], 8-bit normals, 8-bit deviation over ±1, 32-bit faces."""
        # Points and faces are stored as differences, which compress much better.
        points = np.round(np.clip(self.points / reach, -1, 1) * 32767).astype("<i2")
        normals = np.round(self.normals * 127).astype("i1")
        shade = np.round(np.clip(deviation, -1, 1) * 127).astype("i1")
        arrays = {
            "points": np.diff(points, axis=0, prepend=np.zeros((1, 3), "<i2")),
            "normals": normals,
            "shade": shade,
            "faces": np.diff(self.faces.ravel().astype("<i4"), prepend=np.zeros(1, "<i4")),
        }
        return {name: base64.b64encode(zlib.compress(a.tobytes())).decode() for name, a in arrays.items()}


NOTHING = Surface(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3), np.uint32))


def iso_surface(field: np.ndarray, level: float, pitch: float) -> Surface:
    """The surface where a field [x, y, z] crosses ``level``, closed at its edges; [mm] from the grid's middle."""
    from skimage.measure import marching_cubes

    block = max(1, ceil(max(field.shape) / LARGEST))
    coarse = np.pad(block_mean(field, block), 1)
    if not coarse.max() > level or not coarse.min() < level:
        return NOTHING
    points, faces, _, _ = marching_cubes(coarse, level, gradient_direction="ascent")
    edge = np.array([ceil(n / block) * block for n in field.shape]) - np.array(field.shape)
    middle = (np.array(coarse.shape) - 1) / 2 - edge / (2 * block)
    return Surface((points - middle) * (block * pitch), vertex_normals(points, faces), faces)


def stray(proof: Proof) -> Surface:
    """Resin beyond the judged cylinder that prints, and a ball at its greatest dose; `NOTHING` if there is none."""
    from skimage.measure import marching_cubes
    from trimesh.creation import icosphere

    if proof.outer is None or proof.outer_share < 1.0:
        return NOTHING
    radius, size = proof.operator.grid.inscribed_radius, 2.0 * proof.outer.width
    ball = icosphere(2, size)
    found = [Surface(ball.vertices + np.array(proof.outer.place), ball.vertices / size, ball.faces)]
    pooled: list[np.ndarray] = []
    width = corner = 0.0
    for slab in proof.fine() if proof.independent else ():
        width, corner = slab.pitch * ceil(len(slab.x) / LARGEST), float(slab.x[0])
        distance = np.hypot(slab.x[:, None], slab.y[None, :])
        solid = (slab.dose.numpy() >= proof.solid_from) & ((distance > radius) & (distance <= slab.radius))[:, :, None]
        cells = []
        for axis, places in enumerate((slab.x, slab.y, slab.z)):
            cell, first = np.unique(np.rint((places - corner) / width).astype(np.int64), return_index=True)
            solid = np.logical_or.reduceat(solid, first, axis=axis)
            cells.append(cell)
        pooled.append(np.stack([cell[k] for cell, k in zip(cells, np.nonzero(solid), strict=True)], axis=1))
    if any(map(len, pooled)):
        cells = np.concatenate(pooled)
        low = cells.min(axis=0) - 1
        field = np.zeros(cells.max(axis=0) - low + 2, np.float32)
        field[tuple((cells - low).T)] = 1.0
        points, faces, _, _ = marching_cubes(field, 0.5, gradient_direction="ascent")
        found.append(Surface((points + low) * width + corner, vertex_normals(points, faces), faces))
    return joined(found)


def joined(surfaces: Sequence[Surface]) -> Surface:
    """Several surfaces as one."""
    first = np.cumsum([0, *(len(one.points) for one in surfaces)])
    faces = [one.faces.astype(np.int64) + start for one, start in zip(surfaces, first, strict=False)]
    points, normals = (np.concatenate([getattr(one, name) for one in surfaces]) for name in ("points", "normals"))
    return Surface(points, normals, np.concatenate(faces))


def vertex_normals(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Mean of the normals of the triangles around each point, weighted by area; (n, 3), smoother than gradients."""
    a, b, c = (points[faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    total = np.stack([np.bincount(faces.ravel(), np.repeat(part, 3), len(points)) for part in normal.T], axis=1)
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12)


def block_mean(field: np.ndarray, block: int) -> np.ndarray:
    """Means of cubes of ``block`` voxels; cubes are padded with zeros at the far edges."""
    if block == 1:
        return field
    mean = np.pad(field, [(0, -n % block) for n in field.shape])
    for axis in range(3):  # along the outer axes whole rows are added
        mean = mean.reshape(*mean.shape[:axis], -1, block, *mean.shape[axis + 1 :]).mean(axis=axis + 1)
    return mean


def deviation(printed: Surface, target: Surface) -> np.ndarray:
    """Signed distance [mm] of each printed point from the target's nearest tangent plane, > 0 outside; (n,)."""
    if not len(printed.points) or not len(target.points):
        return np.zeros(len(printed.points))
    from scipy.spatial import KDTree

    _, nearest = KDTree(target.points).query(printed.points, workers=threads())
    return np.einsum("ij,ij->i", printed.points - target.points[nearest], target.normals[nearest])


def viewer(target: Surface, printed: Surface, most: float, outer: Surface = NOTHING) -> dict[str, Any]:
    """Surfaces in the form for the page's script; ``most`` is the deviation [mm] at the ends of the color scale."""
    # ``outer``, the print beyond the judged cylinder, has the greatest value, which the script colors.
    points = np.concatenate([target.points, printed.points, outer.points])
    shade = np.concatenate([np.clip(deviation(printed, target) / most, -1.0, 0.99), np.ones(len(outer.points))])
    reach = float(np.abs(points).max(initial=most))
    return {
        "target": target.packed(np.zeros(len(target.points)), reach),
        "printed": joined([printed, outer]).packed(shade, reach),
        "radius": 2 * float(np.linalg.norm(points, axis=1).max(initial=most)) / reach,
    }

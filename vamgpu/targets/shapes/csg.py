"""Building blocks of the bundled shapes: prisms, rods and booleans that always close."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import numpy.typing as npt
from manifold3d import CrossSection, Error, Manifold, Mesh64, OpType

from vamgpu.errors import MeshError
from vamgpu.targets.solid import Solid

Point = tuple[float, float, float]


def to_solid(body: Manifold, name: str) -> Solid:
    """Turn a manifold3d body [mm] into a centered Solid."""
    if body.status() != Error.NoError:
        raise MeshError(f"{name}: the generated surface is not closed ({body.status()}); choose other dimensions")
    return Solid(*triangles(body), name).centered()


def triangles(body: Manifold) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.int32]]:
    """Vertices [mm] and faces of a body."""
    mesh = body.to_mesh64()
    return np.asarray(mesh.vert_properties)[:, :3], np.asarray(mesh.tri_verts, np.int32)


def from_triangles(vertices: npt.NDArray[np.float64], faces: npt.NDArray[np.integer]) -> Manifold:
    """Make a body of a closed triangle surface: vertices (n, 3) [mm], faces (m, 3) wound outward."""
    # Copies: manifold3d refuses read-only arrays.
    return Manifold(Mesh64(np.array(vertices, np.float64, order="C"), np.array(faces, np.uint64, order="C")))


def union(bodies: Iterable[Manifold]) -> Manifold:
    return Manifold.batch_boolean(list(bodies), OpType.Add)


def polygon(points: npt.ArrayLike) -> CrossSection:
    """A plane figure from the corners (n, 2) [mm] of one counter-clockwise outline."""
    return CrossSection([np.ascontiguousarray(points, dtype=np.float64)])


def box(low: Point, high: Point) -> Manifold:
    """A box between two corners [mm]."""
    size = np.subtract(high, low)
    return Manifold.cube((float(size[0]), float(size[1]), float(size[2]))).translate(low)


def rod(start: Point, end: Point, radius: float, end_radius: float | None = None, segments: int = 48) -> Manifold:
    """A round rod, or a cone, from start to end [mm]."""
    axis = np.subtract(end, start)
    length = float(np.linalg.norm(axis))
    body = Manifold.cylinder(length, radius, radius if end_radius is None else end_radius, segments)
    return along(body, start, end)


def along(body: Manifold, start: Point, end: Point) -> Manifold:
    """Move a body that extends along +z from the origin to extend from start towards end."""
    axis = np.subtract(end, start)
    x, y, z = (axis / np.linalg.norm(axis)).tolist()
    polar, azimuth = np.degrees(np.arctan2(np.hypot(x, y), z)), np.degrees(np.arctan2(y, x))
    return body.rotate((0.0, float(polar), float(azimuth))).translate(start)


def stroke(path: npt.ArrayLike, width: float, segments: int = 16) -> CrossSection:
    """A line of strokes with a round pen of the given width [mm] through the points (n, 2) [mm]."""
    points = np.asarray(path, dtype=np.float64)
    dots = [CrossSection.circle(0.5 * width, segments).translate((float(x), float(y))) for x, y in points]
    return CrossSection.batch_boolean([(a + b).hull() for a, b in zip(dots, dots[1:], strict=False)], OpType.Add)

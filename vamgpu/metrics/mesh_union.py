"""Join overlapping bodies of a mesh; no surface then remains inside the part."""

from __future__ import annotations

import numpy as np

from vamgpu.targets.repair import bodies, repaired
from vamgpu.targets.shapes.csg import from_triangles, triangles, union
from vamgpu.targets.solid import Solid


def joined(solid: Solid) -> Solid:
    """The outer surface of a mesh, and the surfaces of its cavities."""
    # Programs export assemblies as bodies that overlap. A surface inside another body is not a surface of the part.
    # solid [mm]
    from manifold3d import Error

    solid = repaired(solid)
    if not bodies(solid.faces, len(solid.vertices)).any():
        return solid
    whole = from_triangles(solid.vertices, solid.faces)
    if whole.status() != Error.NoError:
        return solid
    parts = whole.decompose()
    outer = [part for part in parts if part.volume() > 0]
    boxes = np.array([body.bounding_box() for body in outer]).reshape(-1, 2, 3)
    if not _overlap(boxes):
        return solid
    for cavity in (part for part in parts if part.volume() < 0):
        low, high = np.array(cavity.bounding_box()).reshape(2, 3)
        around = np.flatnonzero((boxes[:, 0] <= low).all(axis=1) & (boxes[:, 1] >= high).all(axis=1))
        if around.size:
            owner = int(around[np.prod(np.ptp(boxes[around], axis=1), axis=1).argmin()])
            vertices, faces = triangles(cavity)
            outer[owner] -= from_triangles(vertices, faces[:, ::-1])
    return Solid(*triangles(union(outer)), solid.name)


def _overlap(boxes: np.ndarray) -> bool:
    """Whether any two boxes (n, low and high, 3) overlap."""
    for i, (low, high) in enumerate(boxes[:-1]):
        others = boxes[i + 1 :]
        if ((others[:, 0] <= high) & (others[:, 1] >= low)).all(axis=1).any():
            return True
    return False

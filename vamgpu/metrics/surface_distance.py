"""Distances of the surface of a print from its target, > 0 where the print is too thick: J. Toombs et al., Roll-to-roll
tomographic …, Table 1; A. Orth et al., Automatic exposure volumetric additive manufacturing, Fig. 4.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vamgpu.backend.array import DeviceArray
from vamgpu.errors import EmptyMesh
from vamgpu.geometry import centers, counts, positive
from vamgpu.metrics.alignment import Alignment, align
from vamgpu.metrics.nearest_points import Array, Nearest, as_points
from vamgpu.metrics.triangle_search import double_areas, drawn_on
from vamgpu.schema.quantities import numeric
from vamgpu.targets.solid import Solid

POINTS = 20_000  # default number of points drawn on a print's surface


@dataclass(frozen=True, eq=False)
class SurfaceDistance:
    """Signed distances of points of a print from the target's surface, > 0 where the print is too thick."""

    points: Array  # (n, 3) [mm], where the alignment put them
    distance: Array  # (n,) [mm]
    alignment: Alignment | None  # None without alignment

    @property
    def mean(self) -> float:
        """Mean signed distance [mm]."""
        return float(self.distance.mean())

    @property
    def rms(self) -> float:
        """Root mean square of the distance [mm]."""
        return float(np.sqrt(np.mean(self.distance**2)))


def surface_distance(
    printed: Solid | npt.ArrayLike, target: Solid | Nearest, *, aligned: bool = True, start: Alignment | None = None,
    samples: int = POINTS, keep: float = 1.0,
) -> SurfaceDistance:  # fmt: skip
    """Distances of a print from its target."""
    # printed: a mesh, e.g. `iso_solid` of a simulated print or `load_mesh` of a CT scan, on which ``samples`` points
    # are drawn evenly with a fixed seed; or points (n, 3) [mm]. target: a closed surface; its `Nearest` if several
    # prints are compared. aligned: whether to align the print with the target first; start, keep: see `align`.
    surface = target if isinstance(target, Nearest) else Nearest(target)
    cloud = drawn(printed, samples) if isinstance(printed, Solid) else as_points(printed)
    motion = align(cloud, surface, start=start, keep=keep) if aligned else start
    cloud = cloud if motion is None else motion(cloud)
    return SurfaceDistance(cloud, surface(cloud).distance, motion)


def drawn(solid: Solid, samples: int = POINTS) -> Array:
    """Points (samples, 3) [mm] on a surface, uniformly distributed by area, with a fixed seed."""
    number = counts("samples", (samples,), 1)[0]
    corners = solid.vertices[solid.faces]
    if not double_areas(corners).sum() > 0:
        raise EmptyMesh(f"{solid.name}: its {len(solid.faces)} triangles have no area; export the part again")
    return drawn_on(corners, number)[0]


def iso_solid(
    field: DeviceArray | npt.ArrayLike, pitch: tuple[float, float, float] | float, level: float = 0.5,
    name: str = "print",
) -> Solid:  # fmt: skip
    """The surface where a field [x, y, z] or [l, rho, z] crosses a level, closed at the edges of its grid."""
    # pitch: voxel edges [mm]. Coordinates [mm] count from the middle of the grid.
    from skimage.measure import marching_cubes

    given = field.numpy() if isinstance(field, DeviceArray) else field
    values = numeric("the field", given, (3,), "three axes of finite numbers")
    edges = np.array([positive("pitch [mm]", p) for p in np.broadcast_to(np.asarray(pitch, np.float64), 3)])
    if not values.max() > level:
        raise EmptyMesh(f"the field reaches {values.max():g}, which is not above the level of {level:g}: lower it")
    below = min(float(values.min()), level - (float(values.max()) - level))
    closed = np.pad(values, 1, constant_values=below)
    points, faces, _, _ = marching_cubes(closed, level, gradient_direction="ascent")
    low = np.array([centers(n, d)[0] for n, d in zip(closed.shape, edges, strict=True)])
    return Solid(points * edges + low, faces, name)

"""Features of a target that are too thin for its voxels; no score counts them."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
import numpy.typing as npt

from vamgpu.errors import ShapeMismatch
from vamgpu.geometry import Grid
from vamgpu.metrics.nearest_points import nearest
from vamgpu.metrics.triangle_search import Array, double_areas, drawn_on
from vamgpu.metrics.walls import walls
from vamgpu.targets.solid import Solid

IN_THE_PART = 0.5  # least filled share at which a voxel counts as in the part, as in `Parts`
_PER_VOXEL_FACE, _LEAST, _MOST = 2.0, 5_000, 400_000
"""Least and greatest number of sample points on the surface, per voxel face."""
_WIDEST = 2.0  # wall thickness, in voxels, from which the voxels show a wall at any position
_SMALLEST = 0.5  # least volume of a region, in voxels; a smaller one would not fill half of a voxel


@dataclass(frozen=True)
class ThinRegion:
    """A connected feature of the target that its voxels do not show."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]  # corners of the box around it [mm]
    volume: float  # filled volume of its voxels [mm³]
    thickness: float | None  # its greatest wall thickness [mm]; None without a mesh

    @property
    def center(self) -> tuple[float, float, float]:
        """Middle of the box [mm]."""
        x, y, z = (0.5 * (a + b) for a, b in zip(self.low, self.high, strict=True))
        return x, y, z


@dataclass(frozen=True)
class Unjudged:
    """All features that are too thin to be judged on a grid, the largest region first; false if there are none."""

    regions: tuple[ThinRegion, ...]
    pitch: float  # of the grid [mm]

    def __bool__(self) -> bool:
        return bool(self.regions)

    @property
    def volume(self) -> float:
        """Volume of all regions [mm³]."""
        return sum(region.volume for region in self.regions)

    @property
    def thickness(self) -> float | None:
        """Greatest wall thickness of all regions [mm]; None without regions or without a mesh."""
        return max((region.thickness for region in self.regions if region.thickness is not None), default=None)

    def reason(self) -> str:
        """One sentence: what was not judged, where, and what to do; empty if everything was judged."""
        return f"{self.found()} and could not be judged; use smaller voxels or thicker walls" if self.regions else ""

    def found(self) -> str:
        """Features that were not judged, and where; empty if there are none."""
        if not self.regions:
            return ""
        first = self.regions[0]
        thick = "" if self.thickness is None else f", up to {1e3 * self.thickness:.0f} µm thick"
        where = ", ".join(f"{value:.2f}" for value in first.center)
        number, do = (f"{len(self.regions)} parts", "do") if len(self.regions) > 1 else ("1 part", "does")
        return (
            f"{number} of the target ({self.volume:.3g} mm³{thick}; the largest near ({where}) mm) {do} not fill half "
            f"of any {1e3 * self.pitch:.0f} µm voxel"
        )


def unjudged(fraction: npt.ArrayLike, grid: Grid, solid: Solid | None = None) -> Unjudged:
    """Find features that the voxels of a target do not show."""
    # With a mesh: walls without a voxel of the part around their middle, because walls thinner than about a voxel do
    # not fill half of any. Walls of a voxel or more are always judged. Without a mesh: partly filled voxels without a
    # neighbor in the part, because thin walls leave such fractions. Neither method finds a thin wall less than a voxel
    # from a thick one. fraction [x, y, z]
    part = np.asarray(fraction)
    if part.shape != grid.shape:
        raise ShapeMismatch(f"the fractions have shape {part.shape}, the grid {grid.shape}; expected the same")
    regions = _in_voxels(part, grid) if solid is None else _in_mesh(part, grid, solid)
    return Unjudged(tuple(sorted(regions, key=lambda region: -region.volume)), grid.pitch)


def _in_mesh(part: np.ndarray, grid: Grid, solid: Solid) -> list[ThinRegion]:
    corners = solid.vertices[solid.faces]
    area = 0.5 * float(double_areas(corners).sum())
    number = int(np.clip(_PER_VOXEL_FACE * area / grid.pitch**2, _LEAST, _MOST))
    points, face = drawn_on(corners, number)
    a, b, c = np.moveaxis(corners[face], 1, 0)
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    # Half a voxel below the surface of a thick part, every voxel is at least half filled: only others are searched.
    doubtful = ~_shown(part, grid, points - 0.5 * grid.pitch * normals, around=False)
    if not doubtful.any():
        return []
    surface = nearest(solid, 0.5 * grid.pitch).search
    found = walls(surface, points[doubtful], normals[doubtful], _WIDEST * grid.pitch)
    lost = found.is_wall & ~_shown(part, grid, found.center, around=True)
    return _regions(found.center[lost], found.thickness[lost], part, grid)


def _regions(center: Array, thickness: Array, part: np.ndarray, grid: Grid) -> list[ThinRegion]:
    """Regions of points whose voxels touch or have one voxel between them, with the filled volume there."""
    from scipy.ndimage import binary_dilation, label

    index = np.floor(center / grid.pitch + 0.5 * np.asarray(grid.shape)).astype(np.int64)
    on_grid = ((index >= 0) & (index < grid.shape)).all(axis=1)
    index, center, thickness = index[on_grid], center[on_grid], thickness[on_grid]
    if not len(center):
        return []
    first = np.maximum(index.min(axis=0) - 1, 0)
    share = np.asarray(part[tuple(slice(a, b) for a, b in zip(first, index.max(axis=0) + 2, strict=True))])
    index -= first
    marked = np.zeros(share.shape, bool)
    marked[tuple(index.T)] = True
    cube = np.ones((3, 3, 3))
    labels: Any = label(binary_dilation(marked, cube), cube)
    filled = np.where(share < IN_THE_PART, share, 0.0)
    volume = np.bincount(labels[0].ravel(), filled.ravel()) * grid.voxel_volume
    number = labels[0][tuple(index.T)]
    regions = []
    for one in np.unique(number).tolist():
        if volume[one] >= _SMALLEST * grid.voxel_volume:
            rows = number == one
            low, high = center[rows].min(axis=0), center[rows].max(axis=0)
            thick = float(thickness[rows].max())
            regions.append(ThinRegion(tuple(low.tolist()), tuple(high.tolist()), float(volume[one]), thick))
    return regions


def _in_voxels(part: np.ndarray, grid: Grid) -> list[ThinRegion]:
    from scipy.ndimage import binary_dilation, find_objects, label

    cube = np.ones((3, 3, 3))
    box = next(iter(find_objects((part > 0).astype(np.int8))), (slice(0, 1),) * 3)  # around all partly filled voxels
    part, first = part[box], [cut.start for cut in box]
    alone = (part > 0) & np.logical_not(binary_dilation(part >= IN_THE_PART, cube))
    labels: Any = label(alone, cube)
    volume = np.bincount(labels[0].ravel(), part.ravel())[1:] * grid.voxel_volume
    axes, edge = [axis[start:] for axis, start in zip(grid.axes(), first, strict=True)], 0.5 * grid.pitch
    regions = []
    for box, total in zip(find_objects(labels[0]), volume.tolist(), strict=True):
        if total >= _SMALLEST * grid.voxel_volume:
            low = tuple(float(axis[cut.start]) - edge for axis, cut in zip(axes, box, strict=True))
            high = tuple(float(axis[cut.stop - 1]) + edge for axis, cut in zip(axes, box, strict=True))
            regions.append(ThinRegion(low, high, total, None))  # type: ignore[arg-type]
    return regions


def _shown(part: np.ndarray, grid: Grid, points: Array, around: bool) -> npt.NDArray[np.bool_]:
    """Whether the voxel that each point lies in counts as in the part; ``around``: or any of its 26 neighbors."""
    # The middle of an oblique wall that is thick enough may lie in a corner of a voxel that the wall misses; and the
    # rim of every wall ends between voxels.
    at = points / grid.pitch + 0.5 * np.asarray(grid.shape)
    shown = np.zeros(len(points), bool)
    for step in product((-1, 0, 1), repeat=3) if around else [(0, 0, 0)]:
        index = np.floor(at).astype(np.int64) + step
        inside = ((index >= 0) & (index < grid.shape)).all(axis=1)
        shown[inside] |= part[tuple(index[inside].T)] >= IN_THE_PART
    return shown

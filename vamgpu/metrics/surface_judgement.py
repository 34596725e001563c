"""A print judged against its mesh: distances of surfaces, walls, bodies, holes."""

from __future__ import annotations

import warnings
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from math import inf, isnan, nan

import numpy as np
import numpy.typing as npt

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.cores import beside, together
from vamgpu.errors import MeshWarning
from vamgpu.geometry import Grid, counts
from vamgpu.metrics.body_changes import BodyChanges, body_changes
from vamgpu.metrics.mesh_runs import mesh_runs
from vamgpu.metrics.mesh_union import joined
from vamgpu.metrics.nearest_points import Nearest, nearest
from vamgpu.metrics.printed_field import PrintedField, printed_field
from vamgpu.metrics.runs import Runs
from vamgpu.metrics.steadiness import Print
from vamgpu.metrics.surface_distance import iso_solid
from vamgpu.metrics.thin_regions import IN_THE_PART, Unjudged, unjudged
from vamgpu.metrics.topology import Topology, topology
from vamgpu.metrics.triangle_search import Array, TriangleSearch, drawn_on
from vamgpu.metrics.walls import Walls, walls
from vamgpu.reports.line import Line, length
from vamgpu.targets.repair import bodies
from vamgpu.targets.solid import Solid

SAMPLES = 10_000
"""Number of points drawn on each of the two surfaces for the mean, RMS and 95 %, and on the part for its walls."""
_DENSE = 300_000  # greatest number of points on each surface in the search for the greatest distances
_PER_VOXEL_FACE = 1.0
_CANDIDATES = 500
_PIECES = 128
"""Greatest number of pieces of triangles compared with a point; only points equally far from a whole part need more."""
_WIDEST = 4.0  # thickness, in voxels of the part, above which nothing counts as a wall by default


@dataclass(frozen=True)
class WallChanges:
    """Walls of a part that were printed and that were lost, by thickness [mm]; NaN if there are none."""

    # A wall is thinner than four of the part's voxels, or four pixels. It is lost if the dose in its middle stays below
    # the threshold. A sharp edge, which tapers to zero thickness, also counts as a wall.

    share_lost: float  # share of the area of all walls, 0..1
    thinnest_lost: float
    thickest_lost: float  # of those that are lost
    thinnest_printed: float  # of those that are printed


@dataclass(frozen=True, eq=False)
class SurfaceJudgement:
    """Differences of a print from its part in space."""

    # Distances are signed, > 0 where the print is too thick. They are measured from print to part and from part to
    # print: without the second, a missing fin would not show. All are NaN if nothing prints.

    distances: Array = field(repr=False)  # of n points of the print's surface, then of n of the part's, (2 n,) [mm]
    greatest_excess: float  # greatest distance by which the print is too thick [mm], ≥ 0
    greatest_lack: float  # greatest distance by which it is too thin or missing [mm], ≥ 0
    walls: WallChanges  # walls of the part that were lost
    changes: BodyChanges  # bodies, holes and cavities that were lost, joined or gained
    unjudged: Unjudged  # features too thin for the part's voxels
    # lowest and highest one at which bodies, holes, walls and gaps are no worse; None, not measured, if a body is wrong
    thresholds: tuple[float, float] | None

    @property
    def mean(self) -> float:
        """Mean signed distance [mm]."""
        return float(self.distances.mean()) if self.distances.size else nan

    @property
    def rms(self) -> float:
        """Root mean square of the distances [mm]."""
        return float(np.sqrt(np.mean(self.distances**2))) if self.distances.size else nan

    @property
    def p95(self) -> float:
        """The distance [mm] that 95 % of the points do not exceed."""
        return float(np.quantile(np.abs(self.distances), 0.95)) if self.distances.size else nan

    @property
    def greatest(self) -> float:
        """The greatest distance [mm], with its sign."""
        return self.greatest_excess if self.greatest_excess >= self.greatest_lack else -self.greatest_lack

    def lines(self) -> tuple[Line, ...]:
        """Every number with its meaning."""
        w, c = self.walls, self.changes
        greatest, lost = "nothing prints", "none"
        if not isnan(self.mean):
            greatest = f"+{length(self.greatest_excess)} −{length(self.greatest_lack)}"
        if w.share_lost:
            lost = f"{length(w.thinnest_lost)}–{length(w.thickest_lost)}, {100 * w.share_lost:.2g} %"
        bodies = f"{c.bodies_lost} + {c.bodies_merged} + {c.bodies_broken} + {c.bodies_extra} of {c.bodies}"
        thin = "none"
        if self.unjudged:
            thick = "" if self.unjudged.thickness is None else f", up to {length(self.unjudged.thickness)} thick"
            thin = f"{len(self.unjudged.regions)}, {self.unjudged.volume:.3g} mm³{thick}"
        return (
            Line("surface distance, mean", length(self.mean, "+"), "print to part, > 0 where the print is too thick"),
            Line("surface distance, RMS", length(self.rms), "both ways: print to part, and part to print"),
            Line("surface distance, 95 %", length(self.p95), "95 % of both surfaces are closer"),
            Line("surface distance, greatest", greatest, "most too thick, most too thin or missing"),
            Line("walls lost", lost, "thinnest and thickest whose middle did not print, and their share of wall area"),
            Line("thinnest wall printed", length(w.thinnest_printed), "measured along the normal of its surface"),
            Line("bodies changed", bodies, "lost + merged + broken + extra, of the part's bodies"),
            Line("holes changed", f"{c.holes_closed} + {c.holes_opened} of {c.holes}", "through holes closed + opened"),
            Line("cavities changed", f"{c.cavities_filled} + {c.cavities_extra} of {c.cavities}", "filled + extra"),
            Line("too thin to be judged", thin, "parts of the target that do not fill half of any voxel"),
        )


def judge_surface(
    dose: npt.ArrayLike, origin: npt.ArrayLike, pitch: float, threshold: float, fraction: DeviceArray | npt.ArrayLike,
    grid: Grid, solid: Solid | None = None, *, thin: Unjudged | None = None, samples: int = SAMPLES,
    widest: float = 0.0, between: tuple[float, float] = (0.0, inf),
) -> SurfaceJudgement:  # fmt: skip
    """Compare the surface at which a dose reaches the threshold with a part."""
    # Distances are measured between the triangles of both surfaces, not between samples. Bodies, holes and cavities are
    # compared on voxels of the dose's grid; thinner ones are not compared. `unjudged` reports features thinner than the
    # part's voxels. dose [x, y, z]; origin [mm] (3,); pitch [mm]; fraction [x, y, z]; widest wall, if more than four
    # voxels [mm]; between: limits of the thresholds that are searched
    number = counts("samples", (samples,), 1)[0]
    if thin is None:
        solid = None if solid is None else joined(solid)
        fraction = np.asarray(fraction.numpy() if isinstance(fraction, DeviceArray) else fraction)
        thin = unjudged(fraction, grid, solid)
    part = iso_solid(fraction, grid.pitch, IN_THE_PART) if solid is None else solid
    around = printed_field(dose, origin, pitch, threshold, part.bounds)
    inside = mesh_runs(part, around.origin, around.pitch, around.runs.shape)
    printed = beside(lambda: _searched(around))
    # of a surface made from voxels, which the user cannot repair; a filter holds for all threads
    with warnings.catch_warnings(action="ignore", category=MeshWarning) if solid is None else nullcontext():
        near, own, there = together(
            lambda: nearest(part, 0.5 * grid.pitch),
            lambda: _own_bodies(part, topology(inside), around),
            lambda: topology(around.runs),
        )
    changes = body_changes(own, there, around.pitch**3)
    points, face = drawn_on(near.search.corners, number, near.search.areas)
    measured = beside(lambda: _distances(near, points, printed(), inside, around))
    widest = max(_WIDEST * grid.pitch, widest)
    thick, wide = (walls(near.search, points, near.normals[face], widest, gaps) for gaps in (False, True))
    thresholds = Print(around, own, changes, (thick, wide)).thresholds(*between)
    return SurfaceJudgement(*measured(), _wall_changes(thick, around), changes, thin, thresholds)


def _searched(around: PrintedField) -> TriangleSearch | None:
    """The search over the surface of the print; None if nothing prints."""
    surface = around.triangles()
    return TriangleSearch(surface, 0.5 * around.pitch) if len(surface) else None


def _distances(
    near: Nearest, points: Array, printed: TriangleSearch | None, inside: Runs, around: PrintedField
) -> tuple[Array, float, float]:
    """Signed distances at points of the print and of the part, and the greatest excess and lack of all."""
    if printed is None:
        return np.zeros(0), nan, nan

    def of_part(at: Array) -> Array:
        return np.where(around.printed(at), 1.0, -1.0) * printed(at, most=_PIECES)[0]

    def of_print(at: Array) -> Array:
        return near(at, most=_PIECES).distance

    cloud = drawn_on(printed.corners, len(points), printed.areas)[0]
    dense_part, dense_print = _dense(near.search, around.pitch), _dense(printed, around.pitch)
    ways = (
        (of_print, near.search, cloud, dense_print, ~_masked(inside, around, dense_print)),
        (of_part, printed, points, dense_part, around.printed(dense_part)),
    )
    distances = np.concatenate([measured(cloud) for measured, _, cloud, _, _ in ways])
    farthest = [measured(_far(search, dense, thick)) for measured, search, _, dense, thick in ways]
    most = np.concatenate([distances, *farthest])
    return distances, max(float(most.max()), 0.0), max(-float(most.min()), 0.0)


def _own_bodies(part: Solid, found: Topology, around: PrintedField) -> Topology:
    """Bodies on voxels, merged if they belong to one body of the mesh: voxels can break, or pierce, a thin wall."""
    if found.bodies < 2 and not found.holes.any():
        return found
    number = bodies(part.faces, len(part.vertices))
    cuts = np.bincount(number).cumsum()[:-1]
    parted = np.split(part.faces[number.argsort(kind="stable")], cuts)
    pieces = [np.unique(faces, return_inverse=True) for faces in parted]
    meshes = [Solid(part.vertices[used], own.reshape(-1, 3).astype(np.int32)) for used, own in pieces]
    genus = np.array([1 - len(one.vertices) // 2 + len(one.faces) // 4 for one in meshes])  # of closed surfaces
    if found.bodies < 2:
        real = found.holes if len(meshes) > 1 else np.minimum(found.holes, genus)
        return replace(found, holes=real, pierced=int((found.holes - real).sum()))
    group, most = -np.arange(1, found.bodies + 1), np.zeros(found.bodies, np.int64)
    sizes = [np.ptp(one.vertices, axis=0).prod() for one in meshes]
    for k in np.argsort(np.negative(sizes)):  # a cavity comes after its shell
        own = mesh_runs(meshes[k], around.origin, around.pitch, found.runs.shape)
        _, there, both = own.shared(found.runs)
        shared = np.bincount(found.body[there], both.length, found.bodies + 1)[1:].astype(np.int64)
        its = (shared > 0) & (shared >= most)
        group[its], most[its] = k, shared[its]
    return found.together(group, genus)


def _wall_changes(found: Walls, around: PrintedField) -> WallChanges:
    """Thickness of the part's walls, divided by whether their middle prints."""
    printed = around.printed(found.center)
    lost, kept = found.thickness[found.is_wall & ~printed], found.thickness[found.is_wall & printed]
    return WallChanges(
        share_lost=len(lost) / max(len(lost) + len(kept), 1),
        thinnest_lost=float(lost.min(initial=np.inf)) if lost.size else nan,
        thickest_lost=float(lost.max(initial=0.0)) if lost.size else nan,
        thinnest_printed=float(kept.min(initial=np.inf)) if kept.size else nan,
    )


def _dense(search: TriangleSearch, pitch: float) -> Array:
    """Points as dense as the voxels' faces."""
    count = int(np.clip(0.5 * _PER_VOXEL_FACE * search.areas[-1] / pitch**2, 1_000, _DENSE))
    return drawn_on(search.corners, count, search.areas)[0]


def _masked(inside: Runs, around: PrintedField, points: Array) -> npt.NDArray[np.bool_]:
    """Whether the voxel that each point lies in is inside the part."""
    index = np.rint((points - around.origin) / around.pitch).astype(np.int64)
    return inside.holds(np.clip(index, 0, np.array(inside.shape) - 1))


def _far(search: TriangleSearch, points: Array, thick: npt.NDArray[np.bool_]) -> Array:
    """Candidates for the points farthest from a surface, for points where the print is too thick and for the others."""
    low, high = search.bounds(points)
    chosen = []
    for side in (np.flatnonzero(thick), np.flatnonzero(~thick)):
        if side.size:
            side = side[high[side] >= low[side].max()]
            chosen.append(side[np.argsort(-high[side], kind="stable")[:_CANDIDATES]])
    return points[np.concatenate(chosen)]

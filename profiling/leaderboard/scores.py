"""Scores of a dose against the part's mesh, by NumPy, SciPy and scikit-image alone."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import ceil, nan
from pathlib import Path

import numpy as np
from scipy.ndimage import distance_transform_edt, label
from scipy.spatial import KDTree
from skimage.measure import euler_number

from profiling.leaderboard.judge import Exposure

REACH = 2.0
"""Pixels from the surface up to which distances are exact."""
DRAWN = 12
"""Points drawn on the mesh for each pixel's area, to find the triangles near a voxel."""
NEAREST = 4
"""Points whose triangles are compared."""
LEVELS = 2000
"""Doses tried for the best overlap."""
ALIKE = 0.02
"""Difference of overlaps (intersection over union) that does not matter for the threshold."""
STEP, STEPS = 1.0125, 24
"""Ratio of the thresholds that are tried, and their number on either side of the one of the best overlap."""
SHIFT = np.array([1.7e-7, 2.3e-7])
"""Columns are moved by this share of a voxel, so that none meets an edge of the mesh."""


def read_stl(path: Path) -> np.ndarray:
    """Corners of the triangles of a binary STL file, [triangle, corner, xyz]."""
    data = path.read_bytes()
    count = int.from_bytes(data[80:84], "little")
    if len(data) != 84 + 50 * count:
        raise ValueError(f"{path} has {len(data)} bytes; expected {84 + 50 * count}, a binary STL of {count} triangles")
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    return np.frombuffer(data, record, count, 84)["corners"].astype(np.float64)


def inside(triangles: np.ndarray, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Which points of an even grid a mesh encloses, [x, y, z]: the surface winds around them."""
    origin, step = np.array([x[0], y[0]]), np.array([x[1] - x[0], y[1] - y[0]])
    flat = (triangles[:, :, :2] - origin) / step - SHIFT
    first = np.maximum(np.ceil(flat.min(1)).astype(int), 0)
    count = np.maximum(np.minimum(np.floor(flat.max(1)).astype(int), [x.size - 1, y.size - 1]) - first + 1, 0)
    of = np.repeat(np.arange(len(flat)), count.prod(1))
    place = np.arange(of.size) - np.repeat(np.cumsum(count.prod(1)) - count.prod(1), count.prod(1))
    at = first[of] + np.stack([place // count[of, 1], place % count[of, 1]], axis=1)
    a, b, c = (flat[of, k] for k in range(3))
    area = _cross(b - a, c - a)
    shares = np.stack([_cross(b - at, c - at), _cross(c - at, a - at), _cross(a - at, b - at)], axis=1)
    met = (area != 0.0) & (shares * np.sign(area)[:, None] > 0.0).all(1)
    height = (shares[met] * triangles[of[met], :, 2]).sum(1) / area[met]
    winding = np.zeros((x.size, y.size, z.size + 1), np.int32)
    np.add.at(winding, (*at[met].T, np.searchsorted(z, height)), -np.sign(area[met]).astype(np.int32))
    return winding.cumsum(axis=2)[:, :, :-1] > 0


def distance(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Distance of each point from its triangle, [n]."""
    edges = np.roll(triangles, -1, axis=1) - triangles
    normal = np.cross(edges[:, 0], edges[:, 1])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    away = points[:, None] - triangles
    above = (np.einsum("nkj,nj->nk", np.cross(edges, away), normal) >= 0.0).all(1)
    along = np.einsum("nkj,nkj->nk", away, edges) / np.maximum(np.einsum("nkj,nkj->nk", edges, edges), 1e-30)
    beside = np.linalg.norm(away - np.clip(along, 0.0, 1.0)[:, :, None] * edges, axis=2).min(1)
    return np.where(above, np.abs(np.einsum("nj,nj->n", away[:, 0], normal)), beside)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


@dataclass(frozen=True)
class Counts:
    """Pieces of a solid, holes through it, and cavities in it."""

    bodies: int
    holes: int
    cavities: int

    @classmethod
    def of(cls, solid: np.ndarray) -> Counts:
        """Solid voxels meet at corners, voids at faces; the space around the part is no cavity."""
        solid = np.pad(solid, 1)
        bodies, cavities = label(solid, np.ones((3, 3, 3)))[1], label(~solid)[1] - 1  # type: ignore[index, operator]
        return cls(bodies, bodies + cavities - int(euler_number(solid, connectivity=3)), cavities)

    def differ(self, other: Counts) -> int:
        """Pieces, holes and cavities too many or too few."""
        return sum(abs(a - b) for a, b in zip(vars(self).values(), vars(other).values(), strict=True))


class Part:
    """A part on the voxels of an exposure.

    Args:
        exposure: Gives the voxels.
        triangles: Of the part, [triangle, corner, xyz] [mm].
    """

    def __init__(self, exposure: Exposure, triangles: np.ndarray) -> None:
        self.exposure, self.pixel = exposure, exposure.setup.pixel
        self._triangles = triangles
        self.solid = inside(triangles, exposure.x, exposure.x, exposure.z)
        self.judged = np.broadcast_to(exposure.inside[:, :, None], self.solid.shape)
        self.volume = (
            float(np.einsum("nj,nj->n", triangles[:, 0], np.cross(triangles[:, 1], triangles[:, 2])).sum()) / 6.0
        )

    @cached_property
    def counts(self) -> Counts:
        return Counts.of(self.solid & self.judged)

    @cached_property
    def depth(self) -> np.ndarray:
        """Distance below the surface [pixels], < 0 outside, at most `REACH`, [x, y, z]."""
        sign, voxels = np.where(self.solid, 1.0, -1.0), self.pixel / self.exposure.voxel
        near = np.asarray(distance_transform_edt(self.solid)) + np.asarray(distance_transform_edt(~self.solid))
        i, j, k = np.nonzero(near <= voxels * REACH + 2.0)
        points = np.stack([self.exposure.x[i], self.exposure.x[j], self.exposure.z[k]], axis=1)
        tree, owner = self._drawn
        away = np.full(len(points), np.inf)
        for found in np.atleast_2d(tree.query(points, NEAREST)[1].T):
            away = np.minimum(away, distance(points, self._triangles[owner[found]]))
        depth = REACH * sign
        depth[i, j, k] *= np.minimum(away / self.pixel / REACH, 1.0)
        return depth

    @cached_property
    def _drawn(self) -> tuple[KDTree, np.ndarray]:
        """Points drawn evenly on the mesh, and the triangle of each."""
        a, b, c = self._triangles.swapaxes(0, 1)
        area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
        random, count = np.random.default_rng(1), ceil(DRAWN * area.sum() / self.pixel**2)
        owner = np.concatenate([random.choice(len(area), count, p=area / area.sum()), np.nonzero(area)[0]])
        s, t = random.random((2, owner.size, 1))
        s, t = np.where(s + t > 1.0, 1.0 - s, s), np.where(s + t > 1.0, 1.0 - t, t)
        return KDTree(a[owner] + s * (b - a)[owner] + t * (c - a)[owner]), owner

    def window(self, rate: np.ndarray, away: float) -> float:
        """Least dose deeper than ``away`` pixels less the greatest farther outside, over the greatest."""
        within, without = (rate[self.judged & far] for far in (self.depth >= away, self.depth <= -away))
        return float((within.min() - without.max()) / rate[self.judged].max()) if within.size else nan

    def threshold(self, rate: np.ndarray) -> tuple[float, float, float]:
        """The dose rate from which resin counts as solid, and its range.

        Of the thresholds whose overlap with the part is within `ALIKE` of the best, that with the fewest pieces, holes
        and cavities too many or too few. The range, as two ratios to it, is that around it in which none is; both are
        1 if there is no such range.
        """
        values, solid = rate[self.judged], self.solid[self.judged]
        edges = np.linspace(0.0, values.max(), LEVELS + 1)
        within, without = (np.histogram(values[of], edges)[0][::-1].cumsum()[::-1] for of in (solid, ~solid))
        overlap = within / (solid.sum() + without)
        tried = float(edges[np.argmax(overlap)]) * STEP ** np.arange(-STEPS, STEPS + 1.0)
        like = np.interp(tried, edges[:-1], overlap)
        wrong = np.array([Counts.of((rate >= at) & self.judged).differ(self.counts) for at in tried])
        best = int(np.lexsort((-like, wrong, like < like.max() - ALIKE))[0])
        if wrong[best]:
            return float(tried[best]), 1.0, 1.0
        bad = np.concatenate([[-1], np.nonzero(wrong)[0], [len(wrong)]])
        first, last = bad[bad < best].max() + 1, bad[bad > best].min() - 1
        return float(tried[best]), float(tried[first] / tried[best]), float(tried[last] / tried[best])

    def off(self, rate: np.ndarray, at: float) -> np.ndarray:
        """Distance [pixels] from the mesh of the places between neighbors where the dose crosses a threshold."""
        found = []
        for axis in range(3):
            value, depth, judged = (np.moveaxis(each, axis, 0) for each in (rate, self.depth, self.judged))
            met = ((value[:-1] >= at) != (value[1:] >= at)) & judged[:-1] & judged[1:]
            a, b, deep, following = value[:-1][met], value[1:][met], depth[:-1][met], depth[1:][met]
            found.append(deep + (following - deep) * ((at - a) / (b - a)))
        return np.abs(np.concatenate(found))


def scores(part: Part, light: np.ndarray, rate: np.ndarray) -> dict[str, float | int | bool]:
    """What light [angle, column, row] prints, with its dose rate [x, y, z]: numbers in µm, s, mJ and shares."""
    setup = part.exposure.setup
    at, lowest, highest = part.threshold(rate)
    solid = (rate >= at) & part.judged
    found, off = Counts.of(solid), 1e3 * part.pixel * part.off(rate, at)
    seconds = setup.critical_dose / at
    power = float(light.mean(0).sum()) * setup.pitch**2 * setup.irradiance * setup.lit_share
    return {
        "bodies": found.bodies, "holes": found.holes, "cavities": found.cavities,
        "right": found == part.counts, "wrong": found.differ(part.counts),
        "rms_um": float(np.sqrt(np.mean(off**2))), "p95_um": float(np.quantile(off, 0.95)),
        "W0.5": part.window(rate, 0.5), "W1": part.window(rate, 1.0),
        "latitude": highest / lowest - 1.0,
        "stray": float((solid & (part.depth <= -1.0)).sum()) * part.exposure.voxel**3 / part.volume,
        "lacking": float((~solid & part.judged & (part.depth >= 1.0)).sum()) * part.exposure.voxel**3 / part.volume,
        "overlap": float((solid & part.solid).sum() / (solid | (part.solid & part.judged)).sum()),
        "seconds": seconds, "energy_mJ": power * seconds, "threshold": at,
    }  # fmt: skip

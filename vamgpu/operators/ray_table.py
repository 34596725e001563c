"""Tables of one angle for bent or absorbed light: the ray that reaches a point, and the range of a column's light."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass
from functools import cached_property, lru_cache
from math import ceil, hypot, inf, sqrt
from typing import Any

import numpy as np

from vamgpu.backend.cores import pointwise
from vamgpu.errors import BadInput
from vamgpu.geometry import Beam, Chords, Grid, Vessel, centers
from vamgpu.kernels.footprint import half_support, sides

FINE = 65_536
SAFETY = 1.5  # safety factor on the errors measured midway between samples of the map
ROUNDING = 0.01  # rounding error of float32 [voxels]
TOGETHER = 4  # neighboring columns whose rays a device follows together
WIDE = 0.5  # angle [rad] between the chords of `TOGETHER` columns above which all voxels of a row are checked
EQUAL = 1.05  # relative difference in width up to which voxels count as equally wide as a column's light


@dataclass(frozen=True)
class OpenAir(Vessel):
    """No vessel: straight rays, no absorption, light everywhere.

    absorption: none.  lit_radius: of the light [mm].
    """

    absorption: float = 0.0  # pyright: ignore[reportIncompatibleMethodOverride] - a field
    lit_radius: float = inf  # pyright: ignore[reportIncompatibleMethodOverride] - a field

    def chords(self, u: np.ndarray) -> Chords:
        zero = np.zeros_like(u)
        return Chords(p=u, angle=zero, spread=zero, transmittance=np.ones_like(u), length=np.full_like(u, inf))

    def illuminate(self, across: np.ndarray, along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return across, np.ones_like(across)


@dataclass(frozen=True)
class RayTable:
    """Tables of one angle; lengths in voxels, columns counted from 0."""

    # map: (n, n, 4) column, strength, and the columns per voxel across and along the light. radius: of the lit disc.
    # steepest: greatest number of columns per voxel. moving: the same with the motion of voxels while an angle is lit,
    # the root of the sum of both squares. fill, sigma: of a pixel's box and point spread. bounds: finds the edges.

    map: np.ndarray
    radius: float
    steepest: float
    moving: float
    fill: float
    sigma: float
    bounds: Callable[[], np.ndarray]

    @cached_property
    def edges(self) -> np.ndarray:
        """Chords on either side of a column's light, and slack, (columns, 8); only forward projections need them."""
        return self.bounds()

    @property
    def taps(self) -> int:
        """Greatest number of columns that light one voxel."""
        return int(2.0 * float(half_support(*_widest(self.moving, self.sigma), self.fill, self.sigma))) + 1

    @property
    def cells(self) -> int:
        """Greatest number of voxels of a row that `TOGETHER` neighboring columns light."""
        far = np.minimum(np.arange(len(self.edges)) + TOGETHER - 1, len(self.edges) - 1)
        low, high = self.edges[:, :4], self.edges[far, 4:]
        turned = np.arctan2(high[:, 2], high[:, 1]) - np.arctan2(low[:, 2], low[:, 1])
        across = np.abs(high[:, 0] - low[:, 0]) + np.abs(turned) * min(self.radius, len(self.map))
        return min(int(np.max(np.sqrt(2.0) * across) + 2.0 * self.edges[:, 3].max()) + 2, len(self.map))


def tabulate(grid: Grid, beam: Beam, vessel: Vessel, half: float | None = None, arc: float = 0.0) -> RayTable:
    """The tables of ``vessel`` for a grid and a beam."""
    # half: columns from a voxel's middle to the farthest that lights it, for kernels that follow columns one by one;
    # None: from footprints and point spread, for kernels that follow `TOGETHER`. arc: greatest arc [rad] of the turn
    # while an angle is lit.
    columns = beam.pixels[0]
    corner = hypot(*(0.5 * (n - 1) for n in grid.shape[:2]))
    radius = min(vessel.lit_radius / grid.pitch, corner + 1.0)
    samples = 2 * (ceil(min(radius, corner)) + 2)
    whole, shares = unwrap(vessel)
    sampled = _sampled if _never_changes(whole) else _sampled.__wrapped__
    u, weight = sampled(whole, radius * grid.pitch, samples, grid.pitch)
    column = u / beam.pitch + 0.5 * (columns - 1)
    strength = weight * grid.pitch**2 / beam.pitch  # a row of the operator then sums to the length of its ray
    gradient = np.gradient(column)
    column, strength = _over_voxels(column, strength)
    for share in shares:
        strength = strength * share(u, *_square(samples, grid.pitch))
    fill, sigma = sqrt(beam.fill), beam.sigma
    reaches = _reaches(column, columns, radius, fill, sigma, arc) if half is None else np.full(columns, half)
    rays = _Rays(grid, beam, vessel, reaches)
    table = np.stack([column, strength, *gradient], axis=-1)
    together = TOGETHER if half is None else 1
    steepest, moving = _steepest(column, radius), _steepest(column, radius, arc)

    def bounds() -> np.ndarray:
        return rays.edges(_slack(column, radius, rays), min(radius, corner), together)

    return RayTable(table, radius, steepest, moving, fill, sigma, bounds)


def column_in_resin(beam: Beam, vessel: Vessel) -> float:
    """Width of a column of the beam in the resin, on the axis [mm]."""
    center = vessel.chords(np.array([-1e-3, 1e-3]) * beam.pitch).p
    return float(center[1] - center[0]) / 2e-3


def _widest(gradient: float | np.ndarray, sigma: float) -> tuple[np.ndarray, np.ndarray]:
    """The two boxes of a voxel seen along its diagonal."""
    side = np.sqrt(0.5) * np.asarray(gradient)
    return sides(side, side, sigma)


def _gradient(column: np.ndarray, arc: float = 0.0) -> np.ndarray:
    """Greatest number of columns per voxel in each cell of the map; ``arc`` [rad] adds motion while lit."""
    across, along = np.abs(np.diff(column, axis=0)), np.abs(np.diff(column, axis=1))
    across, along = np.maximum(across[:, 1:], across[:, :-1]), np.maximum(along[1:], along[:-1])
    far = np.abs(np.arange(len(across)) - 0.5 * (len(across) - 1)) + 0.5
    return np.hypot(np.hypot(across, along), arc * (across * far + along * far[:, None]))


def _near(shape: tuple[int, ...], radius: float) -> np.ndarray:
    """Cells of the map from which a lit voxel may read."""
    position = np.arange(shape[0] - 1) - 0.5 * (shape[0] - 2)
    return np.hypot(position[:, None], position[None, :]) <= radius + 1.0


def _steepest(column: np.ndarray, radius: float, arc: float = 0.0) -> float:
    return float(_gradient(column, arc)[_near(column.shape, radius)].max())


def _reaches(
    column: np.ndarray, columns: int, radius: float, fill: float, sigma: float, arc: float
) -> np.ndarray:  # fmt: skip
    """Reach [columns] of each column's light to either side of its middle."""
    near, gradient = _near(column.shape, radius), _gradient(column, arc)
    place = np.clip(0.5 * (column[:-1, :-1] + column[1:, 1:])[near], 0, columns - 1).astype(int)
    steep = np.zeros(columns)
    np.maximum.at(steep, place, gradient[near])
    most = float(half_support(*_widest(float(gradient[near].max()), sigma), fill, sigma))
    around = int(np.ceil(most)) + 2
    padded = np.pad(steep, around, mode="edge")
    steep = np.max([padded[k : k + columns] for k in range(2 * around + 1)], axis=0)
    return half_support(*_widest(steep, sigma), fill, sigma)


def unwrap(vessel: Any) -> tuple[Vessel, list[Callable[..., np.ndarray]]]:
    """The vessel itself, and the share of its light that each wrapper passes."""
    # Shares may jump at the edge of a shadow, and those sorted by focus must sum to one; they are not smoothed.
    shares = []
    while hasattr(vessel, "bare"):
        shares.append(vessel.share)
        vessel = vessel.bare
    return vessel, shares


def _never_changes(vessel: Any) -> bool:
    """Whether equal vessels of its class do the same to light: their compared fields are all that they hold."""
    kind = type(vessel)
    try:
        hash(vessel)
        held = {k: v for k, v in vars(vessel).items() if not isinstance(getattr(kind, k, None), cached_property)}
    except TypeError:
        return False
    if not getattr(vars(kind).get("__dataclass_params__"), "frozen", False):
        return False
    compared = {each.name for each in fields(vessel) if each.compare}
    return compared >= held.keys() and all(_never_changes(each) for each in held.values() if is_dataclass(each))


def _square(samples: int, pitch: float) -> list[np.ndarray]:
    """Across and along the light: points of a square about the axis."""
    return list(np.meshgrid(*2 * (centers(samples, pitch),), indexing="ij"))


@lru_cache(maxsize=1)  # for other beams in the same vessel: tracing takes most of the time of a table
def _sampled(vessel: Vessel, radius: float, samples: int, pitch: float) -> tuple[np.ndarray, np.ndarray]:
    """The light at points of a square, continued straight beyond ``radius`` [mm]: voxels at the rim interpolate."""
    across, along = _square(samples, pitch)
    distance = np.hypot(across, along)
    beyond = (distance > radius) & (distance < 2.0 * radius)
    u, weight = np.empty_like(across), np.empty_like(across)
    u[~beyond], weight[~beyond] = vessel.illuminate(across[~beyond], along[~beyond])
    if not beyond.any():
        return u, weight
    x, y, far = across[beyond], along[beyond], distance[beyond]
    rim, mirror = radius * (1.0 - 1e-9) / far, (2.0 * radius - far) / far
    rim_u, rim_weight = vessel.illuminate(x * rim, y * rim)
    inner_u, inner_weight = vessel.illuminate(x * mirror, y * mirror)
    u[beyond] = 2.0 * rim_u - inner_u
    weight[beyond] = np.maximum(2.0 * rim_weight - inner_weight, 0.0)
    return u, weight


def _over_voxels(column: np.ndarray, strength: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Samples with which linear interpolation gives, to second order, the mean column and strength of a voxel."""
    # A voxel's mean is its middle's + ∇²/24; linear interpolation between samples is ∇²/12 above it on average. Where
    # strength changes, the brighter side has more weight in the mean of the column: by a sixth of the column's own
    # change if one edge is dark.
    steep, brighter = np.gradient(column), np.gradient(strength)
    most = np.hypot(*steep) / 6.0
    leaning = (steep[0] * brighter[0] + steep[1] * brighter[1]) / 12.0
    pulled = np.clip(np.divide(leaning, strength, out=np.zeros_like(column), where=strength > 0.0), -most, most)
    return column + pulled - _curvature(column) / 24.0, np.maximum(strength - _curvature(strength) / 24.0, 0.0)


def _curvature(value: np.ndarray) -> np.ndarray:
    """∇² per voxel², 0 across the edge of the table."""
    total = np.zeros_like(value)
    total[1:-1] += value[2:] - 2.0 * value[1:-1] + value[:-2]
    total[:, 1:-1] += value[:, 2:] - 2.0 * value[:, 1:-1] + value[:, :-2]
    return total


class _Rays:
    """Chords [voxels] by column index, only of rays that enter the resin."""

    def __init__(self, grid: Grid, beam: Beam, vessel: Vessel, reaches: np.ndarray) -> None:
        self.columns, self.reaches, self.reach = beam.pixels[0], reaches, float(reaches.max())
        self._fine = np.linspace(-self.reach, self.columns - 1 + self.reach, FINE)
        chords = vessel.chords((self._fine - 0.5 * (self.columns - 1)) * beam.pitch)
        entering = chords.transmittance > 0
        if not entering.any():
            raise BadInput("no column of the beam reaches the resin; widen the beam or check the vessel's radius")
        self._fine = self._fine[entering]
        self._p, self._angle = chords.p[entering] / grid.pitch, chords.angle[entering]

    def at(self, column: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distance p [voxels] and angle d of the chords of fractional columns; the outermost ray beyond the last."""
        return np.interp(column, self._fine, self._p), np.interp(column, self._fine, self._angle)

    def edges(self, slack: np.ndarray, radius: float, together: int) -> np.ndarray:
        """(columns, 8): p, cos d, sin d, slack of the chords on either side of the light of each column."""
        # A device gathers between the first chord of ``together`` columns and the last; slack covers chords outside
        # that space. If no chord is near all of them, both edges are one chord and slack spans the grid.
        columns = np.arange(self.columns)
        (low_p, low), (high_p, high) = self.at(columns - self.reaches), self.at(columns + self.reaches)
        slack = slack.copy()
        for first in range(0, self.columns, together):
            final = min(first + together, self.columns) - 1
            p, angle = self.at(np.linspace(first - self.reaches[first], final + self.reaches[final], 16))
            if np.ptp(angle) > WIDE:
                high_p[final], high[final] = low_p[first], low[first]
                slack[first] = sqrt(2.0) * (abs(low_p[first]) + 2.0 * radius)
            else:
                slack[first] += max_chord_deviation(p, angle, radius)
        parts = (low_p, np.cos(low), np.sin(low), slack, high_p, np.cos(high), np.sin(high), slack)
        return np.stack(parts, axis=-1)


def max_chord_deviation(p: np.ndarray, angle: np.ndarray, radius: float) -> float:
    """Greatest distance [voxels], along a row of voxels, of chords from the space between the first and the last."""
    reach = np.sqrt(np.maximum(radius**2 - p**2, 0.0))
    along = np.linspace(-1.0, 1.0, 33)[:, None] * reach
    x, y = -p * np.sin(angle) - along * np.cos(angle), p * np.cos(angle) - along * np.sin(angle)
    first, last = (y * np.cos(angle[i]) - x * np.sin(angle[i]) - p[i] for i in (0, -1))
    # a row crosses the first chord at 45 degrees or more; for the last chord, subtract the angle between the two
    aslant = np.cos(0.25 * np.pi + np.abs(angle[-1] - angle[0]))
    beyond = np.minimum(np.sqrt(2.0) * np.abs(first), np.abs(last) / aslant)
    return float(beyond[first * last > 0.0].max(initial=0.0))


def _slack(column: np.ndarray, radius: float, rays: _Rays) -> np.ndarray:
    """Error [voxels] of the map midway between its samples, from each column's true chords; (columns,)."""
    position = np.arange(column.shape[0]) - 0.5 * (column.shape[0] - 1)
    slack = np.zeros(rays.columns + 2)
    for a, b in ((0.5, 0.0), (0.0, 0.5), (0.5, 0.5)):
        near = (1 - b) * column[:-1, :-1] + b * column[:-1, 1:]
        far = (1 - b) * column[1:, :-1] + b * column[1:, 1:]
        u = (1 - a) * near + a * far
        x, y = position[:-1, None] + a, position[None, :-1] + b
        p, angle = (each.reshape(u.shape) for each in pointwise(rays.at, u.ravel()))
        stray = np.abs(x * np.cos(angle) + y * np.sin(angle) - p)
        lit = (x**2 + y**2 <= (radius + 1.0) ** 2) & (u > -1 - rays.reach) & (u < rays.columns + rays.reach)
        index = np.clip(np.floor(u[lit]).astype(int) + 1, 0, rays.columns + 1)
        np.maximum.at(slack, index, stray[lit])
    reach = int(np.ceil(rays.reach)) + 1
    padded = np.pad(slack, reach)
    spread = np.max([padded[k : k + slack.size] for k in range(2 * reach + 1)], axis=0)
    return SAFETY * np.sqrt(2.0) * spread[1:-1] + ROUNDING

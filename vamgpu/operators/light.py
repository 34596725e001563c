"""Tables of one pose for bent or absorbed light: which ray reaches a point, and where a column's light falls."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, hypot, inf

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.geometry import Beam, Chords, Grid, Vessel

FINE = 65_536
SAFETY = 1.5
"""On the strays measured midway between samples of the map."""
ROUNDING = 0.01
"""Voxels that float32 may be off by."""
EQUAL = 1.05
"""Voxels up to this much wider than a column's light count as equally wide: the ripple stays below five percent."""


@dataclass(frozen=True)
class OpenAir:
    """No vessel at all: straight rays, nothing absorbed, light everywhere."""

    absorption: float = 0.0
    lit_radius: float = inf

    def chords(self, u: np.ndarray) -> Chords:
        zero = np.zeros_like(u)
        return Chords(p=u, angle=zero, spread=zero, transmittance=np.ones_like(u), length=np.full_like(u, inf))

    def illuminate(self, across: np.ndarray, along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return across, np.ones_like(across)


@dataclass(frozen=True)
class Light:
    """Tables of the refracting projector; lengths in voxels, columns counted from 0.

    map: (n, n, 2) column index and weight.  edges: (columns, 8).  width: of a voxel in columns, at least 1.
    radius: of the lit disc in voxels.
    """

    map: np.ndarray
    edges: np.ndarray
    width: float
    radius: float


def tabulate(grid: Grid, beam: Beam, vessel: Vessel) -> Light:
    """The tables of ``vessel`` for a grid and a beam. Raises `BadInput` for a beam of a single column."""
    columns = beam.pixels[0]
    if columns < 2:
        raise BadInput(f"a beam of {columns} column cannot be interpolated; give it at least 2")
    corner = hypot(*(0.5 * (n - 1) for n in grid.shape[:2]))
    radius = min(vessel.lit_radius / grid.pitch, corner + 1.0)
    samples = 2 * (ceil(min(radius, corner)) + 2)
    position = (np.arange(samples) - 0.5 * (samples - 1)) * grid.pitch
    u, weight = _continued(vessel, radius * grid.pitch, *np.meshgrid(position, position, indexing="ij"))
    column = u / beam.pitch + 0.5 * (columns - 1)
    strength = weight * grid.pitch**2 / beam.pitch  # so that a row of the operator sums to the length of its ray
    width = _voxel_width(grid, beam, vessel)
    rays = _Rays(grid, beam, vessel, width)
    table = np.stack([column, strength], axis=-1)
    return Light(table, rays.edges(_slack(column, radius, rays)), width, radius)


def _continued(
    vessel: Vessel, radius: float, across: np.ndarray, along: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The light at each point, continued in a straight line beyond ``radius`` [mm] where it ends there.

    Voxels at the rim interpolate between samples on both sides of it: a map that broke off would halve their light
    and send them to a wrong column.
    """
    u, weight = (np.array(value) for value in vessel.illuminate(across, along))
    distance = np.hypot(across, along)
    beyond = (distance > radius) & (distance < 2.0 * radius) & (weight == 0.0)
    if not beyond.any():
        return u, weight
    x, y, far = across[beyond], along[beyond], distance[beyond]
    rim, mirror = radius * (1.0 - 1e-9) / far, (2.0 * radius - far) / far
    rim_u, rim_weight = vessel.illuminate(x * rim, y * rim)
    inner_u, inner_weight = vessel.illuminate(x * mirror, y * mirror)
    u[beyond] = 2.0 * rim_u - inner_u
    weight[beyond] = np.maximum(2.0 * rim_weight - inner_weight, 0.0)
    return u, weight


def _voxel_width(grid: Grid, beam: Beam, vessel: Vessel) -> float:
    """A voxel's width in columns; 1 for columns as wide or wider, between which voxels interpolate."""
    center = vessel.chords(np.array([-1e-3, 1e-3]) * beam.pitch).p
    column_in_resin = float(center[1] - center[0]) / 2e-3
    ratio = grid.pitch / column_in_resin
    return 1.0 if ratio <= EQUAL else ratio


class _Rays:
    """Chords in voxels by column index, kept to rays that enter the resin."""

    def __init__(self, grid: Grid, beam: Beam, vessel: Vessel, width: float) -> None:
        self.columns, self.reach = beam.pixels[0], 0.5 * (1.0 + width)
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

    def edges(self, slack: np.ndarray) -> np.ndarray:
        """(columns, 8): p, cos d, sin d, slack of the chords on either side of the light of each column."""
        sides = []
        for side in (-self.reach, self.reach):
            p, angle = self.at(np.arange(self.columns) + side)
            sides += [p, np.cos(angle), np.sin(angle), slack]
        return np.stack(sides, axis=-1)


def _slack(column: np.ndarray, radius: float, rays: _Rays) -> np.ndarray:
    """How far [voxels] the interpolated map strays from each column's true chords; (columns,).

    A device that gathers along a chord must look this much further to find every voxel that the map sends to it.
    The map bends most midway between its samples, so that is where it is asked.
    """
    position = np.arange(column.shape[0]) - 0.5 * (column.shape[0] - 1)
    slack = np.zeros(rays.columns + 2)
    for a, b in ((0.5, 0.0), (0.0, 0.5), (0.5, 0.5)):
        near = (1 - b) * column[:-1, :-1] + b * column[:-1, 1:]
        far = (1 - b) * column[1:, :-1] + b * column[1:, 1:]
        u = (1 - a) * near + a * far
        x, y = position[:-1, None] + a, position[None, :-1] + b
        p, angle = rays.at(u)
        stray = np.abs(x * np.cos(angle) + y * np.sin(angle) - p)
        lit = (x**2 + y**2 <= (radius + 1.0) ** 2) & (u > -1 - rays.reach) & (u < rays.columns + rays.reach)
        index = np.clip(np.floor(u[lit]).astype(int) + 1, 0, rays.columns + 1)
        np.maximum.at(slack, index, stray[lit])
    reach = int(np.ceil(rays.reach)) + 1
    padded = np.pad(slack, reach)
    spread = np.max([padded[k : k + slack.size] for k in range(2 * reach + 1)], axis=0)
    return SAFETY * np.sqrt(2.0) * spread[1:-1] + ROUNDING

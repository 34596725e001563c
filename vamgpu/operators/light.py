"""Tables of one pose for bent or absorbed light: which ray reaches a point, and where a column's light falls."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, hypot, inf

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.geometry import Beam, Chords, Grid, Vessel

FINE = 65_536
EQUAL = 1.05
"""Voxels up to this much wider than a column's light count as equally wide: the ripple stays below five percent."""


@dataclass(frozen=True)
class OpenAir:
    """No vessel at all: straight rays, nothing absorbed, light everywhere."""

    absorption: float = 0.0
    printable_radius: float = inf

    def chords(self, u: np.ndarray) -> Chords:
        zero = np.zeros_like(u)
        return Chords(p=u, angle=zero, spread=zero, transmittance=np.ones_like(u), length=np.full_like(u, inf))

    def illuminate(self, across: np.ndarray, along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return across, np.ones_like(across)


@dataclass(frozen=True)
class Light:
    """Tables of the refracting projector; lengths in voxels, columns counted from 0.

    map: (n, n, 2) column index and weight.  edges: (columns, 8).  width: half-width of a column's tent in columns.
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
    radius = min(vessel.printable_radius / grid.pitch, corner + 1.0)
    samples = 2 * (ceil(min(radius, corner)) + 2)
    position = (np.arange(samples) - 0.5 * (samples - 1)) * grid.pitch
    u, weight = vessel.illuminate(*np.meshgrid(position, position, indexing="ij"))
    column = u / beam.pitch + 0.5 * (columns - 1)
    strength = weight * grid.pitch**2 / beam.pitch  # so that a row of the operator sums to the length of its ray
    width = _tent_width(grid, beam, vessel)
    return Light(np.stack([column, strength], axis=-1), _edges(grid, beam, vessel, width), width, radius)


def _tent_width(grid: Grid, beam: Beam, vessel: Vessel) -> float:
    """Columns finer than voxels need a tent as wide as a voxel, or rays would slip between voxels."""
    center = vessel.chords(np.array([-1e-3, 1e-3]) * beam.pitch).p
    column_in_resin = float(center[1] - center[0]) / 2e-3
    ratio = grid.pitch / column_in_resin
    return 1.0 if ratio <= EQUAL else ratio


def _edges(grid: Grid, beam: Beam, vessel: Vessel, width: float) -> np.ndarray:
    """Chords ``width`` columns to either side of each column, kept to rays that enter the resin."""
    u = beam.columns()
    fine = np.linspace(u[0] - width * beam.pitch, u[-1] + width * beam.pitch, FINE)
    entering = fine[vessel.chords(fine).transmittance > 0]
    if not entering.size:
        raise BadInput("no column of the beam reaches the resin; widen the beam or check the vessel's radius")
    sides = []
    for side in (-width, width):
        chord = vessel.chords(np.clip(u + side * beam.pitch, entering[0], entering[-1]))
        sides += [chord.p / grid.pitch, np.cos(chord.angle), np.sin(chord.angle), np.zeros_like(u)]
    return np.stack(sides, axis=-1)

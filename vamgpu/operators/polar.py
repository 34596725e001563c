"""Rings about the axis of rotation as voxels of a volume: rotations from angle to angle map them onto themselves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import groupby
from math import ceil, pi
from typing import Protocol

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.cores import FEW, ahead
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.geometry import FULL_TURN, Beam, Grid, Vessel, centers, columns_of, counts
from vamgpu.kernels.footprint import half_support, sides
from vamgpu.kernels.ring_table import ring_pose
from vamgpu.kernels.spectrum import ROWS
from vamgpu.schema import check
from vamgpu.schema.quantities import Length

PARTS = 2  # number of parts of a cell along the radius and along the angle whose footprints are added
SMOOTH = 0.7
"""Share of the lit radius within which columns change evenly enough to be compared a ring apart: to 0.003 of one."""
ALIKE = 1e-5
"""Greatest difference between light and its mirror image, relative or in columns, for which one half suffices."""


@dataclass(frozen=True)
class RingBand:
    """Neighboring rings of equally many cells."""

    # begin, stop: range of the rings. cell: first of its cells per turn. samples: number per ring between two angles.

    begin: int
    stop: int
    cell: int
    samples: int

    @property
    def rings(self) -> int:
        return self.stop - self.begin

    @property
    def tiles(self) -> list[RingBand]:
        """The groups of `ROWS` rings."""
        return [replace(self, begin=ring, stop=ring + ROWS) for ring in range(self.begin, self.stop, ROWS)]


@dataclass(frozen=True)
class PolarGrid:
    """Rings of voxels about the axis of rotation: cells are about as long as rings are wide.

    Each ring has a whole number of cells between two angles of the turntable; a rotation by one angle therefore maps
    the grid onto itself. A volume is ``[angle, cell, z]``. Between angle t and the next, cell q of ring j is stored at
    ``[t, band.cell + q · band.rings + j − band.begin]``.

    Args:
        rings: Number of rings, a multiple of eight.
        slices: Voxels along z, an even number.
        pitch: Width of a ring [mm].
        angles: Even angles of the turntable, two or more.
        height: Height of a slice [mm]; None for the ring width.

    Raises:
        BadInput: A value is out of its range.
    """

    rings: int
    slices: int
    pitch: Length
    angles: int
    height: Length | None = None

    def __post_init__(self) -> None:
        for name in ("rings", "slices", "angles"):
            object.__setattr__(self, name, counts(f"PolarGrid {name}", (getattr(self, name),), 1)[0])
        check(self)
        if self.rings % ROWS:
            more = -(-self.rings // ROWS) * ROWS
            raise BadInput(f"PolarGrid rings is {self.rings}; expected a multiple of {ROWS}: use {more}")
        if self.angles < 2:
            raise BadInput(f"PolarGrid angles is {self.angles}; expected 2 or more, even over a full turn")
        if self.slices % 2:
            raise BadInput(f"PolarGrid slices is {self.slices}; expected an even number: use {self.slices + 1}")

    @cached_property
    def bands(self) -> tuple[RingBand, ...]:
        """Rings of equally many cells, from the axis outward."""
        found: list[RingBand] = []
        firsts = range(0, self.rings, ROWS)
        for samples, those in groupby(firsts, self._samples):
            blocks = list(those)
            cell = found[-1].cell + found[-1].rings * found[-1].samples if found else 0
            found.append(RingBand(blocks[0], blocks[-1] + ROWS, cell, samples))
        return tuple(found)

    def _samples(self, first: int) -> int:
        """Number of cells between two angles, for the `ROWS` rings from one on."""
        return ceil(2.0 * pi * (first + ROWS) / self.angles - 1e-9)

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of angles, of cells between two of them, and of slices."""
        last = self.bands[-1]
        return (self.angles, last.cell + last.rings * last.samples, self.slices)

    @cached_property
    def places(self) -> tuple[np.ndarray, np.ndarray]:
        """Middles of the cells.

        Returns:
            Distance from the axis (cells,) [mm] and angle φ (angles, cells) [rad].
        """
        radius, turn = [], []
        for band in self.bands:
            rings = np.arange(band.begin, band.stop) + 0.5
            radius.append(np.tile(rings * self.pitch, band.samples))
            turn.append(np.repeat(np.arange(band.samples) / band.samples, band.rings))
        start = np.arange(self.angles)[:, None]
        return np.concatenate(radius), FULL_TURN / self.angles * (start + np.concatenate(turn))

    @cached_property
    def areas(self) -> np.ndarray:
        """Ratio of the area of each cell to that of a square of the pitch, (cells,)."""
        samples = np.concatenate([np.full(b.rings * b.samples, b.samples * self.angles) for b in self.bands])
        return 2.0 * pi * self.places[0] / self.pitch / samples

    @property
    def box(self) -> Grid:
        """Cubes as high as the slices, in the box about the rings."""
        across = 2 * ceil(self.rings * self.pitch / self.slice_pitch - 1e-9)
        return Grid((across, across, self.slices), self.slice_pitch)

    @property
    def slice_pitch(self) -> float:
        """Height of a slice [mm]."""
        return self.pitch if self.height is None else self.height

    @classmethod
    def within(cls, grid: Grid, angles: int) -> PolarGrid:
        """Rings as wide as the voxels of a box, out to the cylinder in it that light reaches at every angle.

        Args:
            grid: The voxels.
            angles: Even angles of the turntable.

        Returns:
            The rings, with one slice more than the box if that has an odd number.

        Raises:
            BadInput: There are fewer than two angles.
        """
        rings = -(-min(grid.shape[:2]) // (2 * ROWS)) * ROWS
        return cls(rings, grid.shape[2] + grid.shape[2] % 2, grid.pitch, angles)

    @property
    def z(self) -> np.ndarray:
        """Middles of the slices [mm], (slices,)."""
        return centers(self.slices, self.slice_pitch)


class PoseTile(Protocol):
    """The light of one angle in `ROWS` rings."""

    @property
    def arcs(self) -> np.ndarray:
        """Arcs [rad] over which each ring is averaged, (2, `ROWS`)."""
        ...

    def is_mirrored(self, columns: int) -> bool:
        """Whether cells on one side see only columns on that side."""
        ...

    def last(self, beam: Beam) -> int:
        """The last column that may light a cell; −1 if there is none."""
        ...

    def pose(self, beam: Beam, shape: tuple[int, ...], device: Device) -> WritesPose:
        """A function that writes the light of some columns in the (angles, cells) of the rings, on a device."""
        ...


WritesPose = Callable[[int, float, DeviceArray], None]
"""Writes light of columns from a first one on to a field [angle, cell, column]; the first is multiplied by a factor."""


def writes_stored(light: np.ndarray, begin: int, shape: tuple[int, ...], device: Device) -> WritesPose:
    """As of `PoseTile.pose`, for stored light (cells of `ROWS` rings, columns from ``begin`` on)."""
    light = light.reshape(ROWS, shape[0], shape[1] // ROWS, -1).transpose(1, 2, 0, 3).reshape(*shape, -1)

    def write(first: int, factor: float, out: DeviceArray) -> None:
        some = light[..., first - begin : first - begin + out.shape[2]]
        pose = np.pad(some, ((0, 0), (0, 0), (0, out.shape[2] - some.shape[2])))
        pose[..., 0] *= factor
        device.put(pose, out)

    return write


@dataclass(frozen=True)
class _Footprints:
    """Trapezoids for the parts of cells, each (parts · rings, parts · cells of a ring)."""

    # column: that lights the middle.  strength: of a column's light.  a, b: widths [columns].  arc: of the turn [rad]
    # during which an angle is lit.

    column: np.ndarray
    strength: np.ndarray
    a: np.ndarray
    b: np.ndarray
    parts: int
    arc: float

    @property
    def arcs(self) -> np.ndarray:
        return np.repeat([[self.arc], [0.0]], ROWS, axis=1)

    def rings(self, begin: int, stop: int) -> _Footprints:
        """The trapezoids of some of the rings."""
        own = slice(begin * self.parts, stop * self.parts)
        return replace(self, **{name: getattr(self, name)[own] for name in ("column", "strength", "a", "b")})

    def is_mirrored(self, columns: int) -> bool:
        """Whether cells on one side see only columns on that side."""

        def beyond(values: np.ndarray) -> np.ndarray:  # parts lie on both sides of a cell's middle
            return np.roll(values[:, ::-1], 1 if self.parts == 1 else self.parts, axis=1)

        most = float(self.strength.max())
        return bool(
            np.abs(self.strength - beyond(self.strength)).max() <= ALIKE * most
            and (np.abs(self.column + beyond(self.column) - (columns - 1)) * (self.strength > 0.0)).max() <= ALIKE
            and all((np.abs(w - beyond(w)) * (self.strength > 0.0)).max() <= ALIKE for w in (self.a, self.b))
        )

    def last(self, beam: Beam) -> int:
        """The last column that may light a cell; −1 if there is none."""
        reach = half_support(*sides(self.a, self.b, beam.sigma), beam.fill**0.5, beam.sigma)
        return min(int(np.floor(self.column + reach)[self.strength > 0.0].max(initial=-1)), beam.pixels[0] - 1)

    def pose(self, beam: Beam, shape: tuple[int, ...], device: Device) -> WritesPose:
        (angles, cells), parts = shape, self.parts
        whole = np.round(self.column)
        given = np.stack([whole, self.column - whole, self.strength, self.a, self.b], axis=-1)
        given = given.reshape(ROWS, parts, angles, cells // ROWS, parts, 5).transpose(2, 3, 0, 1, 4, 5)
        feet = device.table(given.reshape(angles, cells, parts**2, 5))
        pixel = {"fill": beam.fill**0.5, "sigma": beam.sigma}
        return lambda first, factor, out: device.launch(
            ring_pose, feet=feet, first=first, columns=beam.pixels[0] - first, factor=factor, **pixel, pose=out
        )


def tiles_of_vessel(
    grid: PolarGrid, beam: Beam, vessel: Vessel, square: float | None = None, splines: bool = False, arc: float = 0.0
) -> list[_Footprints]:
    """The light of a vessel in every `ROWS` rings, by threads."""
    # square: side [mm] of squares about the middles of the cells, facing the axis, that take the place of cells and
    # pitch.  splines: whether `ring_splines` interpolate.  arc: of the turn [rad] during which an angle is lit.
    if square is not None:  # those of a ring do not depend on those of another: as many pieces as tiles
        tiles = [tile for band in grid.bands for tile in band.tiles]
        return list(ahead(lambda tile: _in_squares(grid, tile, beam, vessel, square, splines, arc), tiles, FEW))
    found = ahead(lambda band: _footprints(grid, band, beam, vessel, arc), grid.bands, FEW)
    return [
        each.rings(begin, begin + ROWS)
        for band, each in zip(grid.bands, found, strict=True) for begin in range(0, band.rings, ROWS)
    ]  # fmt: skip


def _footprints(grid: PolarGrid, band: RingBand, beam: Beam, vessel: Vessel, arc: float) -> _Footprints:
    """Trapezoids of the parts of a band's cells."""
    count = PARTS * grid.angles * band.samples
    rho = (np.arange(PARTS * band.rings) + 0.5)[:, None] / PARTS + band.begin
    psi = FULL_TURN / count * (np.arange(count) - 0.5 * (PARTS - 1))
    across, along = rho * grid.pitch * np.sin(psi), -rho * grid.pitch * np.cos(psi)
    u, weight = vessel.illuminate(across, along)
    column = u / beam.pitch + 0.5 * (beam.pixels[0] - 1)
    a = np.abs(np.gradient(column, axis=0, edge_order=2))
    b = 0.5 * np.abs(np.roll(column, -1, axis=1) - np.roll(column, 1, axis=1))
    lit = np.hypot(across, along) <= vessel.lit_radius
    strength = weight * lit * (rho / (np.floor(rho) + 0.5)) * grid.pitch**2 / beam.pitch / PARTS**2
    return _Footprints(column, strength, a, b, PARTS, arc)


def _in_squares(
    grid: PolarGrid, band: RingBand, beam: Beam, vessel: Vessel, side: float, splines: bool, arc: float
) -> _Footprints:
    """Squares about the middles of a band's cells."""
    # splines overshoot where light ends: with splines, unlit outer rings therefore repeat the last lit one.
    count = grid.angles * band.samples
    rho = (np.arange(band.begin, band.stop) + 0.5)[:, None] * grid.pitch
    lit = rho <= vessel.lit_radius
    if splines and 0.5 * grid.pitch <= vessel.lit_radius:
        rho = np.minimum(rho, (np.floor(vessel.lit_radius / grid.pitch - 0.5) + 0.5) * grid.pitch)
        lit = np.ones_like(lit)
    psi = FULL_TURN / count * np.arange(count)
    radii, own = np.unique(rho, return_inverse=True)

    def traced(radius: np.ndarray) -> np.ndarray:
        return columns_of(vessel, radius * np.sin(psi), -radius * np.cos(psi)) / beam.pitch

    u, weight = vessel.illuminate(radii[:, None] * np.sin(psi), -radii[:, None] * np.cos(psi))
    u /= beam.pitch
    across = 2.0 * radii[:, None] * np.sin(FULL_TURN / count)
    b = np.abs(np.roll(u, -1, axis=1) - np.roll(u, 1, axis=1)) * (side / across)
    if radii[-1] < SMOOTH * vessel.lit_radius:  # rings beside each other show how fast columns change along the radius
        inner, outer = traced(rho[[0, -1]] + [[-grid.pitch], [grid.pitch]])
        a = np.abs(np.vstack([u[1:], outer]) - np.vstack([inner, u[:-1]])) * (0.5 * side / grid.pitch)
    else:
        a = np.abs(traced(radii[:, None] + 0.5 * side) - traced(radii[:, None] - 0.5 * side))
    each = (u + 0.5 * (beam.pixels[0] - 1), weight * (side**2 / beam.pitch), a, b)
    column, strength, a, b = (values[own.ravel()] for values in each)
    return _Footprints(column, strength * lit, a, b, 1, arc)

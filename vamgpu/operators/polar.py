"""Rings about the axis of rotation as voxels of a volume: rotations by the even angles map them onto themselves."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import groupby
from math import ceil, pi
from typing import Protocol

import numpy as np

from vamgpu.backend.cores import FEW, threads
from vamgpu.backend.cores import pool as workers
from vamgpu.errors import BadInput
from vamgpu.geometry import FULL_TURN, Beam, Grid, Vessel, centers, columns_of, counts
from vamgpu.kernels.footprint import half_support, share, sides
from vamgpu.kernels.spectrum import ROWS
from vamgpu.operators.ring_splines import of_tile, to_coefficients
from vamgpu.schema import check
from vamgpu.schema.quantities import Length

PARTS = 2
"""Number of parts of a cell along the radius and along the angle whose footprints are added."""
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
    the grid onto itself. A volume is ``[angle, cell, z]``: cell q of ring j between angle t and the next lies at ``[t,
    band.cell + q · band.rings + j − band.begin]``.

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


def pose_on_rings(
    grid: PolarGrid, beam: Beam, vessel: Vessel, square: float | None = None
) -> Iterator[np.ndarray]:  # fmt: skip
    """Yield the light of each column in the cells of each band at θ = 0 [mm], (rings, cells of a ring, columns)."""
    # Means over a cell × pitch² / pixel pitch; a cell is cut into parts whose projections are trapezoids. square: side
    # [mm] of squares about the middles of the cells, facing the axis, that replace cells and pitch.
    for band in grid.bands:
        found = np.zeros((band.rings, grid.angles * band.samples, beam.pixels[0]))
        _footprints(grid, band, beam, vessel, square).add(found, beam)
        yield found


class PoseTile(Protocol):
    """The light of one angle in `ROWS` rings."""

    def is_mirrored(self, columns: int) -> bool:
        """Whether cells on one side see only columns on that side."""
        ...

    def last(self, beam: Beam) -> int:
        """The last column that may light a cell; −1 if there is none."""
        ...

    def add(self, found: np.ndarray, beam: Beam, first_column: int = 0) -> None:
        """Add shares of the columns from one on to cells, (rings, cells of a ring, columns)."""
        ...


@dataclass(frozen=True)
class _Footprints:
    """Trapezoids for the parts of cells, each (parts · rings, parts · cells of a ring)."""

    # column: the one that lights the middle. strength: of a column's light. a, b: widths [columns].

    column: np.ndarray
    strength: np.ndarray
    a: np.ndarray
    b: np.ndarray
    parts: int

    def rings(self, begin: int, stop: int) -> _Footprints:
        """The trapezoids of some of the rings."""
        own = slice(begin * self.parts, stop * self.parts)
        return _Footprints(self.column[own], self.strength[own], self.a[own], self.b[own], self.parts)

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

    def add(self, found: np.ndarray, beam: Beam, first_column: int = 0) -> None:
        """Add shares of the columns from one on to cells, (rings, cells of a ring, columns)."""
        fill, sigma, parts = beam.fill**0.5, beam.sigma, self.parts
        for part in np.ndindex(parts, parts):
            own = tuple(slice(each, None, parts) for each in part)
            column, strength, a, b = (each[own] for each in (self.column, self.strength, self.a, self.b))
            reach = half_support(*sides(a, b, sigma), fill, sigma)
            first = np.ceil(column - reach).astype(int)
            for tap in range(int(np.floor(2.0 * reach.max())) + 1):
                at = first + (tap - first_column)
                hit = np.nonzero((strength != 0.0) & (at >= 0) & (at < found.shape[2]))
                apart = column[hit] - (first[hit] + tap)
                found[(*hit, at[hit])] += strength[hit] * share(apart, a[hit], b[hit], fill, sigma)


def _footprints(
    grid: PolarGrid, band: RingBand, beam: Beam, vessel: Vessel, square: float | None, splines: bool = False
) -> _Footprints:
    """Trapezoids of the parts of a band's cells, or of squares in their place."""
    if square is not None:
        return _in_squares(grid, band, beam, vessel, square, splines)
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
    return _Footprints(column, strength, a, b, PARTS)


def _in_squares(grid: PolarGrid, band: RingBand, beam: Beam, vessel: Vessel, side: float, splines: bool) -> _Footprints:
    """Squares about the middles of a band's cells."""
    # splines overshoot where light ends: with splines, unlit outer rings therefore repeat the last lit one.
    count = grid.angles * band.samples
    rho = (np.arange(band.begin, band.stop) + 0.5)[:, None] * grid.pitch
    lit = rho <= vessel.lit_radius
    if splines and 0.5 * grid.pitch <= vessel.lit_radius:
        rho = np.minimum(rho, (np.floor(vessel.lit_radius / grid.pitch - 0.5) + 0.5) * grid.pitch)
        lit = np.ones_like(lit)
    psi = FULL_TURN / count * np.arange(count)

    def place(outward: float, onward: float) -> tuple[np.ndarray, np.ndarray]:
        far = rho + outward
        return far * np.sin(psi) + onward * np.cos(psi), -far * np.cos(psi) + onward * np.sin(psi)

    middle, weight = vessel.illuminate(*place(0.0, 0.0))
    a, b = (
        np.abs(columns_of(vessel, *place(*way)) - columns_of(vessel, *place(*(-step for step in way)))) / beam.pitch
        for way in ((0.5 * side, 0.0), (0.0, 0.5 * side))
    )
    first = middle / beam.pitch + 0.5 * (beam.pixels[0] - 1)
    return _Footprints(first, weight * lit * side**2 / beam.pitch, a, b, 1)


@dataclass(frozen=True)
class RingTable:
    """Entries, tiles and their light, as in `vamgpu.kernels.spectrum`; no entry exceeds ``greatest``."""

    entries: np.ndarray
    greatest: float
    tiles: np.ndarray
    lit: np.ndarray
    mirrored: bool


def ring_table(
    grid: PolarGrid, beam: Beam, vessel: Vessel, square: float | None = None, faint: float = 0.0,
    room: Callable[[tuple[int, ...]], np.ndarray] = partial(np.empty, dtype=np.float32), splines: bool = False,
    arc: float = 0.0,
    tiles_of_pose: Sequence[PoseTile] | None = None,
) -> RingTable:  # fmt: skip
    """The products of each angular frequency, from the light of one angle; arguments as for `pose_on_rings`."""
    # faint: share of the greatest entry below which entries of a tile's outermost columns are dropped. splines: whether
    # entries give coefficients of `ring_splines` instead of doses. room: allocates the entries. arc: of the turn [rad]
    # during which an angle is lit. tiles_of_pose: light of the angle in every `ROWS` rings, if the vessel does not give
    # it.
    with workers(min(threads(), FEW)) as pool:
        # squares of different rings are independent: as many pieces as tiles
        pieces = [tile for band in grid.bands for tile in band.tiles] if square is not None else list(grid.bands)
        footprints: Sequence[PoseTile] = tiles_of_pose or []
        if not footprints:
            found = list(pool.map(lambda piece: _footprints(grid, piece, beam, vessel, square, splines), pieces))
            footprints = found if square is not None else [
                each.rings(begin, begin + ROWS)
                for band, each in zip(grid.bands, found, strict=True) for begin in range(0, band.rings, ROWS)
            ]  # fmt: skip
        columns, mirrored = beam.pixels[0], all(each.is_mirrored(beam.pixels[0]) for each in footprints)
        half = columns // 2 if mirrored else 0
        all_pairs = _in_rows(columns - half)
        last = [each.last(beam) for each in footprints]
        if splines:  # coefficients fall to a third per ring; include those of the next tile
            last = [*last[1:], 2 * last[-1] - last[-2] if last[1:] else all_pairs + half]
        wide = [min(_in_rows(each + 1 - half), all_pairs) for each in last]
        tiles, own, size = _tiles(grid, wide)
        entries = room((grid.angles // 2 + 1, size))

        def fill(footprint: PoseTile, width: int, numbers: list[int]) -> None:
            found = _spectrum(footprint, beam, grid.angles, len(numbers), half, width, arc)
            for number, values in zip(numbers, found, strict=True):
                tile = of_tile(entries, tiles[number])
                tile[...] = values
                if mirrored and columns % 2:
                    tile[:, :1] *= 0.5

        list(pool.map(fill, footprints, wide, own))
        if splines:
            to_coefficients(entries, tiles, grid, pool)
        peaks = list(pool.map(lambda tile: _greatest(of_tile(entries, tile)), tiles))
    most = max(float(peak.max(initial=0.0)) for peak in peaks)
    if most == 0.0:
        raise BadInput("no column of the beam lights a ring; widen the beam or check the vessel's radius")
    lit = np.stack([_lit(peak > faint * most) for peak in peaks], axis=1)
    return RingTable(entries.ravel(), most, np.array(tiles)[:, [0, 2]], lit, mirrored)


def _tiles(grid: PolarGrid, wide: list[int]) -> tuple[list[tuple[int, int, int]], list[list[int]], int]:
    """Start, pairs and mirror tile of each tile; the tiles of each footprint by number of pairs; and the end."""
    tiles, own = list[tuple[int, int, int]](), [list[int]() for _ in wide]
    start = number = 0
    for band in grid.bands:
        for j in range(band.samples):
            for ring in range(len(band.tiles)):
                own[number + ring].append(len(tiles))
                mate = (band.cell + (band.samples - 1 - j) * band.rings) // ROWS + ring
                tiles.append((start, wide[number + ring], mate))
                start += 2 * ROWS * wide[number + ring]
        number += len(band.tiles)
    return tiles, own, start


def _greatest(entries: np.ndarray) -> np.ndarray:
    """The greatest entry of each frequency and pair, of entries (frequency, pair, 2, `ROWS`)."""
    return np.hypot(entries[:, :, 0], entries[:, :, 1]).max(axis=2)


def _lit(seen: np.ndarray) -> np.ndarray:
    """The number of pairs, in whole `ROWS`, up to the last visible one, of (frequency, pair)."""
    ends = np.where(seen, np.arange(1, seen.shape[1] + 1), 0).max(axis=1, initial=0)
    return -(-ends // ROWS) * ROWS


def _in_rows(count: int) -> int:
    """The least multiple of `ROWS` that is at least a number."""
    return -(-max(count, 0) // ROWS) * ROWS


def _spectrum(
    footprints: PoseTile, beam: Beam, turns: int, samples: int, first_column: int, width: int, arc: float
) -> list[np.ndarray]:
    """Entries (k, ``width`` columns, 2, `ROWS`) of `ROWS` rings for each j < samples, at frequencies k + j·turns."""
    # Turning by an arc while lit multiplies a wave by sin(x) / x, x = frequency · arc / 2.
    from scipy.fft import rfft

    columns = min(width, beam.pixels[0] - first_column)
    pose = np.zeros((ROWS, columns, turns * samples), np.float32)
    footprints.add(pose.swapaxes(1, 2), beam, first_column)
    spectrum = np.asarray(rfft(pose, axis=2)) / np.float32(turns * samples)
    found = []
    for j in range(samples):
        kappa, n = np.arange(turns // 2 + 1) + j * turns, turns * samples
        back = 2 * kappa > n
        entries = np.zeros((len(kappa), width, 2, ROWS), np.float32)
        wave = np.where(back, n - kappa, kappa)
        left = np.sinc(wave * (arc / FULL_TURN)).astype(np.float32)
        own = (spectrum[..., wave] * left).transpose(2, 1, 0)
        entries[:, :columns, 0] = np.real(own)
        entries[:, :columns, 1] = np.where(back, np.float32(-1.0), np.float32(1.0))[:, None, None] * np.imag(own)
        found.append(entries)
    return found

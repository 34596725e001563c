"""Rings about the axis of rotation as voxels of a volume: what even angles map onto itself."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import groupby
from math import ceil, pi

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.geometry import FULL_TURN, Beam, Grid, Vessel, centers, counts
from vamgpu.kernels.footprint import half_support, share, sides
from vamgpu.kernels.spectrum import ROWS
from vamgpu.schema import check
from vamgpu.schema.quantities import Length

PARTS = 2
"""Parts of a cell along the radius and along the angle whose footprints are added."""
ALIKE = 1e-5
"""Difference of light from its mirror image, over the greatest, up to which one half stands for both."""


@dataclass(frozen=True)
class Belt:
    """Neighboring rings of equally many cells.

    begin, stop: of the rings.  cell: first of its cells of a turn.  samples: of a ring between two angles.
    """

    begin: int
    stop: int
    cell: int
    samples: int

    @property
    def rings(self) -> int:
        return self.stop - self.begin


@dataclass(frozen=True)
class PolarGrid:
    """Rings of voxels about the axis of rotation: cells are about as long as rings are wide.

    Each ring has a whole number of cells between two angles of the turntable, so that turning it by one of them maps
    the grid onto itself. A volume is ``[angle, cell, z]``: cell q of ring j between angle t and the next lies at
    ``[t, belt.cell + q · belt.rings + j − belt.begin]``.

    Args:
        rings: Rings, a multiple of eight.
        slices: Voxels along z, an even number.
        pitch: Width of a ring [mm].
        angles: Even angles of the turntable, two or more.
        height: Of a slice [mm]; None for that of the width.

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
            raise BadInput(f"PolarGrid rings is {self.rings}; expected a multiple of {ROWS}: take {more}")
        if self.angles < 2:
            raise BadInput(f"PolarGrid angles is {self.angles}; expected 2 or more, even over a full turn")
        if self.slices % 2:
            raise BadInput(f"PolarGrid slices is {self.slices}; expected an even number: take {self.slices + 1}")

    @cached_property
    def belts(self) -> tuple[Belt, ...]:
        """Rings of equally many cells, from the axis outward."""
        found: list[Belt] = []
        firsts = range(0, self.rings, ROWS)
        for samples, those in groupby(firsts, lambda first: ceil(2.0 * pi * (first + ROWS) / self.angles - 1e-9)):
            blocks = list(those)
            cell = found[-1].cell + found[-1].rings * found[-1].samples if found else 0
            found.append(Belt(blocks[0], blocks[-1] + ROWS, cell, samples))
        return tuple(found)

    @property
    def shape(self) -> tuple[int, int, int]:
        """Angles, cells between two of them, slices."""
        last = self.belts[-1]
        return (self.angles, last.cell + last.rings * last.samples, self.slices)

    @cached_property
    def places(self) -> tuple[np.ndarray, np.ndarray]:
        """Middles of the cells.

        Returns:
            Distance from the axis (cells,) [mm] and angle φ (angles, cells) [rad].
        """
        radius, turn = [], []
        for belt in self.belts:
            rings = np.arange(belt.begin, belt.stop) + 0.5
            radius.append(np.tile(rings * self.pitch, belt.samples))
            turn.append(np.repeat(np.arange(belt.samples) / belt.samples, belt.rings))
        start = np.arange(self.angles)[:, None]
        return np.concatenate(radius), FULL_TURN / self.angles * (start + np.concatenate(turn))

    @cached_property
    def areas(self) -> np.ndarray:
        """Area of each cell over that of a square of the pitch, (cells,)."""
        samples = np.concatenate([np.full(b.rings * b.samples, b.samples * self.angles) for b in self.belts])
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
        """Rings as wide as the voxels of a box, out to the cylinder in it that every angle lights.

        Args:
            grid: The voxels.
            angles: Even angles of the turntable.

        Returns:
            The rings, with a slice more than the box where that has an odd number.

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
    """What the columns of the pose at θ = 0 leave in each cell, belt by belt.

    A cell is cut into parts that light sees as trapezoids, as it sees the voxels of a box; the dose is their mean.

    Args:
        grid: The cells.
        beam: The columns.
        vessel: Around them.
        square: Side [mm] of squares about the middles of the cells that take their place; they face the axis.

    Yields:
        Mean over the cell of a column's light × pitch² / pixel pitch [mm], (rings, cells of a ring, columns); the side
        of the squares is the pitch where there are some.
    """
    for belt in grid.belts:
        yield _Seen.of(grid, belt, beam, vessel, square).cells()


@dataclass(frozen=True)
class _Seen:
    """How a beam sees parts of cells: columns of their middles, light, sides; ``parts`` a cell each way."""

    beam: Beam
    column: np.ndarray
    strength: np.ndarray
    a: np.ndarray
    b: np.ndarray
    parts: int

    @classmethod
    def of(cls, grid: PolarGrid, belt: Belt, beam: Beam, vessel: Vessel, square: float | None) -> _Seen:
        """Of a belt; arguments as for `pose_on_rings`."""
        if square is not None:
            return cls._of_squares(grid, belt, beam, vessel, square)
        count = PARTS * grid.angles * belt.samples
        rho = (np.arange(PARTS * belt.rings) + 0.5)[:, None] / PARTS + belt.begin
        psi = FULL_TURN / count * (np.arange(count) - 0.5 * (PARTS - 1))
        across, along = rho * grid.pitch * np.sin(psi), -rho * grid.pitch * np.cos(psi)
        u, weight = vessel.illuminate(across, along)
        column = u / beam.pitch + 0.5 * (beam.pixels[0] - 1)
        a = np.abs(np.gradient(column, axis=0, edge_order=2))
        b = 0.5 * np.abs(np.roll(column, -1, axis=1) - np.roll(column, 1, axis=1))
        lit = np.hypot(across, along) <= vessel.lit_radius
        strength = weight * lit * (rho / _middle(rho)) * grid.pitch**2 / beam.pitch / PARTS**2
        return cls(beam, column, strength, a, b, PARTS)

    @classmethod
    def _of_squares(cls, grid: PolarGrid, belt: Belt, beam: Beam, vessel: Vessel, side: float) -> _Seen:
        """Squares about the middles of a belt's cells."""
        count = grid.angles * belt.samples
        rho = (np.arange(belt.begin, belt.stop) + 0.5)[:, None] * grid.pitch
        psi = FULL_TURN / count * np.arange(count)

        def column(outward: float, onward: float) -> tuple[np.ndarray, np.ndarray]:
            across = (rho + outward) * np.sin(psi) + onward * np.cos(psi)
            along = -(rho + outward) * np.cos(psi) + onward * np.sin(psi)
            u, weight = vessel.illuminate(across, along)
            return u / beam.pitch, weight

        middle, weight = column(0.0, 0.0)
        a, b = (
            np.abs(column(*way)[0] - column(*(-step for step in way))[0])
            for way in ((0.5 * side, 0.0), (0.0, 0.5 * side))
        )
        first = middle + 0.5 * (beam.pixels[0] - 1)
        return cls(beam, first, weight * (rho <= vessel.lit_radius) * side**2 / beam.pitch, a, b, 1)

    def rings(self, first: int) -> _Seen:
        """`ROWS` of the rings."""
        own = slice(self.parts * first, self.parts * (first + ROWS))
        return replace(self, **{name: getattr(self, name)[own] for name in ("column", "strength", "a", "b")})

    @cached_property
    def _reach(self) -> np.ndarray:
        return half_support(*sides(self.a, self.b, self.beam.sigma), self.beam.fill**0.5, self.beam.sigma)

    @property
    def last(self) -> int:
        """The last column that may light a cell; −1 where none does."""
        ends = np.floor(self.column + self._reach)[self.strength > 0.0]
        return min(int(ends.max(initial=-1)), self.beam.pixels[0] - 1)

    def cells(self) -> np.ndarray:
        """Shares of columns in parts of cells, added up by cell, (rings, cells of a ring, columns)."""
        columns, parts = self.beam.pixels[0], self.parts
        rings, cells = self.column.shape
        found = np.zeros((rings // parts, cells // parts, columns))
        first = np.ceil(self.column - self._reach).astype(int)
        ring, cell = np.arange(found.shape[0])[:, None], np.arange(found.shape[1])
        for tap in range(int(np.floor(2.0 * self._reach.max())) + 1):
            at = first + tap
            value = self.strength * share(self.column - at, self.a, self.b, self.beam.fill**0.5, self.beam.sigma)
            value *= (at >= 0) & (at < columns)
            at = np.clip(at, 0, columns - 1)
            for i in range(parts):
                for j in range(parts):
                    part = (slice(i, None, parts), slice(j, None, parts))
                    found[ring, cell, at[part]] += value[part]
        return found


def _middle(rho: np.ndarray) -> np.ndarray:
    """Middle of the ring that each part lies in."""
    return np.floor(rho) + 0.5


@dataclass(frozen=True)
class RingTable:
    """Entries and tiles of `vamgpu.kernels.spectrum`; pairs: of columns, mirrored: whether they mirror each other."""

    entries: np.ndarray
    tiles: np.ndarray
    pairs: int
    mirrored: bool


def ring_table(
    grid: PolarGrid, beam: Beam, vessel: Vessel, square: float | None = None, faint: float = 0.0,
    room: Callable[[tuple[int, ...]], np.ndarray] = partial(np.empty, dtype=np.float32), mirrored: bool = True,
) -> RingTable:  # fmt: skip
    """The products of each angular frequency, from the light of one pose; arguments as for `pose_on_rings`.

    faint: share of the greatest entry up to which those of a tile at neighboring frequencies count as none.
    room: makes the array of the entries, which may be most of what memory holds.
    mirrored: whether columns are taken to mirror each other; where they turn out not to, they are not.
    """
    from scipy.fft import rfft

    columns, turns = beam.pixels[0], grid.angles
    middle = columns // 2 if mirrored else 0
    seen = [_Seen.of(grid, belt, beam, vessel, square) for belt in grid.belts]
    wide = [
        [-(-max(own.rings(ring).last + 1 - middle, 0) // ROWS) * ROWS for ring in range(0, belt.rings, ROWS)]
        for belt, own in zip(grid.belts, seen, strict=True)
    ]
    pairs = np.concatenate([own * belt.samples for belt, own in zip(grid.belts, wide, strict=True)]).astype(int)
    first = np.cumsum(np.concatenate([[0], 2 * ROWS * pairs]))
    entries = room((turns // 2 + 1, int(first[-1])))
    greatest, mates, off = np.zeros((len(pairs), turns // 2 + 1)), np.zeros(len(pairs), int), 0.0
    for belt, own in zip(grid.belts, seen, strict=True):
        for ring in range(0, belt.rings, ROWS):
            pose = own.rings(ring).cells()
            if mirrored:
                image = pose[:, -np.arange(pose.shape[1]), ::-1]
                off = max(off, float(np.abs(pose - image).mean(axis=1).max()))  # no frequency differs by more
            spectrum = rfft(pose[..., middle:], axis=1, workers=-1) / pose.shape[1]
            for j in range(belt.samples):
                tile = (belt.cell + j * belt.rings + ring) // ROWS
                mates[tile] = (belt.cell + (belt.samples - 1 - j) * belt.rings + ring) // ROWS
                rows = _harmonics(spectrum, turns, j, belt.samples)
                greatest[tile] = np.abs(rows).max(axis=(1, 2))
                held = rows[..., : pairs[tile]].swapaxes(1, 2)
                block = np.zeros((len(rows), pairs[tile], 2, ROWS), np.float32)
                block[:, : held.shape[1], 0], block[:, : held.shape[1], 1] = np.real(held), np.imag(held)
                entries[:, first[tile] : first[tile + 1]] = block.reshape(len(rows), -1)
    most = greatest.max(initial=0.0)
    if most == 0.0:
        raise BadInput("no column of the beam lights a ring; widen the beam or check the vessel's radius")
    if off > ALIKE * most:
        return ring_table(grid, beam, vessel, square, faint, room, mirrored=False)
    dark = [_dark(each <= faint * most) for each in greatest]
    tiles = np.column_stack([first[:-1], pairs, mates, np.array(dark).reshape(-1, 2)])
    half = -(-((columns + 1) // 2 if mirrored else columns) // ROWS) * ROWS
    return RingTable(entries.ravel(), tiles, half, mirrored)


def _dark(vanish: np.ndarray) -> tuple[int, int]:
    """The longest run of frequencies that vanish: its first, and the one after it."""
    ends = np.flatnonzero(np.diff(np.concatenate([[0], vanish, [0]])))
    runs = ends.reshape(-1, 2)
    return tuple(runs[np.argmax(runs[:, 1] - runs[:, 0])].tolist()) if len(runs) else (0, 0)


def _harmonics(spectrum: np.ndarray, turns: int, j: int, samples: int) -> np.ndarray:
    """Frequencies k + j·turns of rings for k up to half of the turns, (k, ring, column)."""
    kappa, n = np.arange(turns // 2 + 1) + j * turns, turns * samples
    back = 2 * kappa > n
    found = spectrum[:, np.where(back, n - kappa, kappa)]
    return np.where(back[:, None], found.conj(), found).swapaxes(0, 1)

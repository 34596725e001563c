"""The dose of resin outside the voxels of the judged cylinder: beside it out to the wall, and above and below it.

Beyond the lit radius several rays or none meet a point: cells get the energy that traced rays leave in them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import ceil, hypot, inf, pi, sqrt
from typing import Any, final

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.cores import FEW, ahead
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.geometry import FULL_TURN, Beam, Grid, Turntable, Vessel, centers, positive, resin_radius
from vamgpu.kernels.footprint import TAIL
from vamgpu.kernels.gather import gather_rows
from vamgpu.kernels.spectrum import ROWS
from vamgpu.operators.compose import combine
from vamgpu.operators.defocus import direct
from vamgpu.operators.dwell import Dwell
from vamgpu.operators.linear import LinearOperator
from vamgpu.operators.polar import PolarGrid, WritesPose, writes_stored
from vamgpu.operators.projection import Projection
from vamgpu.operators.ring_projection import RingProjection
from vamgpu.operators.row_resampler import RowResampler, mean_light
from vamgpu.operators.space import SinogramSpace, VolumeSpace
from vamgpu.operators.spectral import SpectralProjection
from vamgpu.operators.traced_projection import BLOCK, SparseEntries
from vamgpu.optics.traced_rays import Rays, traced_rays
from vamgpu.schema.quantities import Thickness

WIDTH = 2.0  # width of a cell beside the part [voxels]
MOST_ANGLES = 1440  # greatest number of evenly spaced angles per turn between which measured angles are placed
TOGETHER = 64  # rows whose crossings a thread finds at once
RAYS, STEPS = 6, 8
"""Rays traced per column, or, if that is more, `STEPS` per ring width; and positions on each ray across one ring."""


@dataclass(frozen=True)
class OuterRings(PolarGrid):
    """Rings from a radius [mm] on, in slices that omit a gap [mm] about the middle."""

    inner: Thickness = 0.0
    gap: Thickness = 0.0

    def _samples(self, first: int) -> int:
        edge = self.inner + (first + ROWS) * self.pitch
        return max(round(2.0 * pi * edge / (self.pitch * self.angles)), 1)

    @cached_property
    def places(self) -> tuple[np.ndarray, np.ndarray]:
        """As of `PolarGrid`."""
        radius, angle = super().places
        return radius + self.inner, angle

    @property
    def z(self) -> np.ndarray:
        """Middles of the slices [mm], (slices,)."""
        z = centers(self.slices, self.slice_pitch)
        return z + 0.5 * self.gap * np.sign(z)

    @cached_property
    def volumes(self) -> np.ndarray:
        """Volume of a cell of each ring [mm³], (cells,)."""
        return self.areas * self.pitch**2 * self.slice_pitch


def outer_resin(A: Any, width: float = WIDTH, height: float = 1.0) -> tuple[OuterResin, ...]:
    """Operators for the resin outside the judged cylinder, where light reaches it. Raises `BadInput`."""
    # One is for the resin beside the cylinder, from its radius to the inner wall (in open air, to the corners of the
    # grid); one is for all resin above and below. Rows of pixels that light no voxel count as dark. width, height: of
    # the cells [voxels].
    A = A if isinstance(A, RingProjection) else direct(A)
    if not isinstance(A, Projection | RingProjection):
        raise BadInput(f"got {A!r}; expected a Projection or a RingProjection, whose light is the same at every "
                       "angle: give the projection of each scenario, color or tile")  # fmt: skip
    return tuple(OuterResin(A, cells) for cells in outer_cells(A.grid, A.beam, A.motion, A.vessel, width, height))


def outer_cells(
    grid: Grid, beam: Beam, motion: Turntable, vessel: Vessel | None, width: float = WIDTH, height: float = 1.0
) -> tuple[OuterRings, ...]:
    """The cells of `outer_resin`, from a projector's geometry."""
    for name, size in (("width", width), ("height", height)):
        positive(f"{name} [voxels]", size)
    wall = resin_radius(vessel)
    judged, pitch, angles = grid.inscribed_radius, grid.pitch, _whole_turn(motion)
    wall = 0.5 * pitch * hypot(*grid.shape[:2]) if wall == inf else wall
    whole = grid.shape[2] * pitch
    inside = 2 * ceil(0.5 * grid.shape[2] / height - 1e-9)
    slice_pitch = whole / inside
    tail = (0.5 * sqrt(beam.fill) + TAIL * beam.sigma) * beam.pitch
    reach = 0.0 if beam.flat else min(0.5 * (beam.pixels[1] - 1) * beam.pitch + tail, 0.5 * whole + 2.0 * tail)
    off = max(ceil((reach - 0.5 * whole) / slice_pitch - 1e-9), 0)
    found = []
    if wall > judged * (1.0 + 1e-9):
        found.append(_cells(judged, wall, width * pitch, inside, slice_pitch, angles))
    if off:
        found.append(_cells(0.0, wall, width * pitch, 2 * off, slice_pitch, angles, gap=whole))
    return tuple(found)


def _whole_turn(motion: Turntable) -> int:
    """Even angles over a full turn that include a turntable's angles; if there are none, half its median step apart."""
    step = float(np.median(np.diff(np.sort(motion.poses)))) if motion.angles > 1 else 0.5 * FULL_TURN
    count = max(round(FULL_TURN / max(step, FULL_TURN / MOST_ANGLES)), 2)
    place = motion.poses / FULL_TURN * count
    if np.abs(place - place.round()).max() < 1e-6:
        return count
    from scipy.fft import next_fast_len

    return next_fast_len(2 * count, real=True) or 2 * count


def _cells(
    inner: float, wall: float, width: float, slices: int, height: float, angles: int, **more: float
) -> OuterRings:
    """Rings about as wide as requested, from a radius to the wall."""
    count = ceil((wall - inner) / width / ROWS - 1e-9) * ROWS
    return OuterRings(count, slices, (wall - inner) / count, angles, height, inner=inner, **more)


@final
class OuterResin(LinearOperator):
    """Light in cells of resin: ``A.T(light)`` is their dose [angle, cell, z], in the units of voxels' dose."""

    # A[i, j] is the mean over cell j of the light of pixel i, × the volume of a voxel / the area of a pixel. Angles
    # that are not evenly spaced are divided among the even angles next to them; arcs count by their mean.

    domain: VolumeSpace

    def __init__(self, A: Projection | RingProjection, cells: OuterRings) -> None:
        self.grid: Grid = A.grid
        self.beam: Beam = A.beam
        self.motion: Turntable = A.motion
        self.vessel: Vessel | None = A.vessel
        self.device: Device = A.device
        self._made = OuterResin, (A, cells)
        self.cells: OuterRings = cells
        self.domain = VolumeSpace(cells)  # pyright: ignore[reportIncompatibleVariableOverride] - and never replaced
        self.range: SinogramSpace = A.range  # pyright: ignore[reportIncompatibleVariableOverride]
        tiles = _tiles(A, cells)
        rest = Turntable(cells.angles, lit_share=0.0)  # tiles know how far each frame turns
        self._spectral = SpectralProjection(cells, A.beam, A.vessel, A.device, faint=3e-4, motion=rest, tiles=tiles)
        self._rows = RowResampler.of(A.beam, cells.slices, cells.slice_pitch, A.device, gap=cells.gap)
        self._dwell = Dwell(A.motion, A.beam, A.device)
        self._turn = _between(A.motion, A.beam.pixels[0], A.device, cells.angles)

    def __repr__(self) -> str:
        return f"OuterResin({self.cells!r}, {self.beam!r}, {self.vessel!r}, device={self.device.name!r})"

    def forward(self, x: DeviceArray, out: DeviceArray) -> None:
        with self._rows.filling(out, self._rows_field) as rows:
            even = rows if self._turn is None else self._field("even", self.cells.angles)
            self._spectral._gather(x, even)
            if self._turn is not None:
                self.device.launch(gather_rows, source=even, **self._turn[0], out=rows)
        self._dwell.weigh(out)

    def transposed(self, y: DeviceArray, out: DeviceArray) -> None:
        even = rows = self._rows.in_slices(self._dwell.weighted(y), self._rows_field)
        if self._turn is not None:
            even = self._field("even", self.cells.angles)
            self.device.launch(gather_rows, source=rows, **self._turn[1], out=even)
        self._spectral._light(even, out)

    def _rows_field(self, shape: tuple[int, ...]) -> DeviceArray:
        return self._spectral._work("rows", shape)

    def _field(self, name: str, angles: int) -> DeviceArray:
        """Light of this number of angles, with one row for each slice."""
        return self._spectral._work(name, (angles, self.beam.pixels[0], self.cells.slices))


def _between(motion: Turntable, columns: int, device: Device, count: int) -> tuple[_Sparse, _Sparse] | None:
    """Tables that convert light of evenly spaced angles to a turntable's, and back; None if they are the same."""
    if motion.theta is None and count == motion.angles:
        return None
    angle = np.arange(motion.angles)
    low, part = np.divmod((motion.poses / FULL_TURN * count).round(6), 1.0)
    pairs = [(low, 1.0 - part), (low + 1, part)]
    rows = np.concatenate([angle] * 2)[:, None] * columns + np.arange(columns)
    even = np.concatenate([np.mod(at, count) for at, _ in pairs]).astype(int)[:, None] * columns + np.arange(columns)
    weights = np.concatenate([share for _, share in pairs])[:, None] * np.ones(columns)
    kept = weights.ravel() != 0.0
    entries = SparseEntries(*(
        each.ravel()[kept].astype(kind) for each, kind in ((rows, np.int32), (even, np.int32), (weights, np.float32))
    ))  # fmt: skip
    there = entries.table(device, (motion.angles, columns), BLOCK)
    return there, entries.transposed().table(device, (count, columns), BLOCK)


@final
class AllResin:
    """A projector and its light in the resin outside its judged cylinder; on rings, light is transformed only once."""

    def __init__(self, A: Any, outer: Sequence[OuterResin] | None = None) -> None:
        self.operator: Any = A
        self.outer: tuple[OuterResin, ...] = tuple(outer_resin(A) if outer is None else outer)

    def expose(self, light: DeviceArray, dose: DeviceArray, cells: Sequence[DeviceArray]) -> None:
        """dose = A.T(light) [x, y, z], and cells = outer.T(light) of each outer operator."""
        together, alone = self._parted(cells)
        for outer, own in alone:
            outer.transposed(light, own)
        if isinstance(self.operator, RingProjection):
            self.operator.transposed_with(light, dose, [(outer._spectral, own) for outer, own in together])
        else:
            self.operator.transposed(light, dose)

    def project(self, dose: DeviceArray, cells: Sequence[DeviceArray], light: DeviceArray) -> None:
        """light = A(dose) + Σ outer(cells), the transpose of `expose`."""
        together, alone = self._parted(cells)
        if isinstance(self.operator, RingProjection):
            self.operator.forward_with(dose, [(outer._spectral, own) for outer, own in together], light)
        else:
            self.operator.forward(dose, light)
        part = light.device.empty(light.shape) if alone else light
        for outer, own in alone:
            outer.forward(own, part)
            combine(1.0, light, 1.0, part, light)

    def _parted(self, cells: Sequence[DeviceArray]) -> tuple[list[_Cells], list[_Cells]]:
        """Operators and their cells: those that share the light of the rings, and the others."""
        A, pairs = self.operator, list(zip(self.outer, cells, strict=True))
        shared = [isinstance(A, RingProjection) and A.takes_with(outer.cells) for outer in self.outer]
        return [p for p, s in zip(pairs, shared, strict=True) if s], [
            p for p, s in zip(pairs, shared, strict=True) if not s
        ]


_Cells = tuple[OuterResin, DeviceArray]
_Sparse = dict[str, DeviceArray]


@dataclass(frozen=True, eq=False)
class _Tile:
    """The light of one angle in `ROWS` rings."""

    # paths: mean over each cell [1/mm] of each ray, (cells, rays), sparse. columns: light of each ray from columns,
    # sparse. arcs: turns [rad] over which each ring is averaged, (2, rings): of a frame; and of rays, which are farther
    # apart than short cells.

    paths: Any
    columns: Any
    mirrored: bool
    arcs: np.ndarray

    def is_mirrored(self, columns: int) -> bool:
        return self.mirrored

    def last(self, beam: Beam) -> int:
        ray = int(self.paths.indices.max(initial=-1))
        return -1 if ray < 0 else int(self.columns.indices[: self.columns.indptr[ray + 1]].max(initial=-1))

    def pose(self, beam: Beam, shape: tuple[int, ...], device: Device) -> WritesPose:
        return writes_stored((self.paths @ self.columns).toarray(), 0, shape, device)


def _tiles(A: Projection | RingProjection, cells: OuterRings) -> list[_Tile]:
    """The tile of every `ROWS` rings."""
    beam = A.beam
    reach = (0.5 * beam.pixels[0] + 4.0 * beam.sigma) * beam.pitch
    spacing = min(beam.pitch / RAYS, cells.pitch / STEPS)
    rays = traced_rays(A.vessel, reach, 2 * ceil(reach / spacing) + 1)
    scale = A.grid.pitch**3 / cells.slice_pitch  # rows count slices, not voxels
    paths, first = _paths(rays, cells)
    columns, mirrored = _columns(rays, beam) * scale, _is_mirrored(rays, cells)
    radius = cells.inner + (np.arange(cells.rings) + 0.5) * cells.pitch
    between = np.where(np.diff(first) / ROWS < FULL_TURN * radius.reshape(-1, ROWS).T / (2.0 * spacing), 0.0, 1.0)
    arcs = np.stack([np.full(cells.rings, A.motion.arcs.mean()), between.T.ravel() * 2.0 * spacing / radius])
    arcs = arcs.reshape(2, -1, ROWS)
    return [_Tile(paths[first[k] : first[k + 1]], columns, mirrored, arcs[:, k]) for k in range(first.size - 1)]


def _columns(rays: Rays, beam: Beam) -> Any:
    """Light that each ray represents, by column, (rays, columns), sparse."""
    from scipy.sparse import csr_array

    edges = np.concatenate([rays.u[:1], 0.5 * (rays.u[1:] + rays.u[:-1]), rays.u[-1:]]) / beam.pitch
    wide, middle = np.diff(edges)[:, None], 0.5 * (edges[1:] + edges[:-1])[:, None]
    apart = middle - beam.columns() / beam.pitch
    return csr_array(mean_light(apart, wide, sqrt(beam.fill), beam.sigma) * wide * rays.transmittance[:, None])


def _is_mirrored(rays: Rays, cells: OuterRings) -> bool:
    """Whether the rays on both sides of the axis are mirror images."""
    far = cells.inner + cells.rings * cells.pitch

    def differ(values: np.ndarray, sign: float) -> float:
        return float(np.abs(values + sign * values[::-1]).max())

    if max(differ(rays.u, 1.0), differ(rays.transmittance, -1.0)) > 1e-6:
        return False
    crossings = [rays.cross(share * far) for share in (-0.6, 0.1, 0.7)]
    return all(max(differ(c.across, 1.0), differ(c.share, -1.0)) < 1e-6 * max(far, 1.0) for c in crossings)


def _paths(rays: Rays, cells: OuterRings) -> tuple[Any, np.ndarray]:
    """Path of each ray in each cell, times its absorption, over the area; sparse; and the first cell of each tile."""
    from scipy.sparse import csr_array

    bands = [tile for band in cells.bands for tile in band.tiles]
    count = np.repeat([band.samples for band in bands], ROWS) * cells.angles
    first = np.concatenate([[0], np.cumsum(count)])
    edges = cells.inner + np.arange(cells.rings + 1) * cells.pitch
    area = 0.5 * (edges[1:] ** 2 - edges[:-1] ** 2) * FULL_TURN / count
    rows = 2 * ceil(edges[-1] / cells.pitch * STEPS)
    step = 2.0 * edges[-1] / rows

    def crossed(along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Cells in which rays cross rows, −1 outside of all, and their paths there over the area; each (rays, rows)."""
        across, cosine, share = rays.cross(along[:, None])
        radius = np.hypot(across, along[:, None])
        ring = np.clip((radius - cells.inner) / cells.pitch, 0, cells.rings - 1).astype(int)
        turn = np.arctan2(across, -along[:, None]) / FULL_TURN
        place = first[ring] + np.floor(turn * count[ring] + 0.5).astype(int) % count[ring]
        inside = (radius >= edges[0]) & (radius < edges[-1]) & (share > 0.0)
        return np.where(inside, place, -1).T, (share * step / cosine / area[ring]).T

    def summed(some: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Cells, rays and paths in some rows; rows that follow each other in a cell are one."""
        place, length = (each.ravel() for each in crossed(some))
        ray = np.repeat(np.arange(rays.u.size), some.size)
        begins = np.flatnonzero(np.diff(place, prepend=-2).astype(bool) | (np.diff(ray, prepend=-1) > 0))
        kept = place[begins] >= 0
        return place[begins][kept], ray[begins][kept], np.add.reduceat(length, begins)[kept]

    parts = ahead(summed, np.array_split(centers(rows, step), ceil(rows / TOGETHER)), FEW)
    place, number, length = (np.concatenate(each) for each in zip(*parts, strict=True))
    return csr_array((length, (place, number)), (int(first[-1]), rays.u.size)), first[::ROWS]

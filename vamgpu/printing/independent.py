"""Frames exposed apart from the operator that solved for them: other rays, other tables, another grid.

Voxels are half as wide as the part's and shifted by a quarter of one, so that their centers lie on the part's centers
and faces; they reach out to the inner wall. Their light comes from traced rays, of which several may meet where
caustics fold them. Resin above and below the grid is exposed on the part's voxels as far as there is light. Nothing
here is read from a solver's operator but its geometry.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from math import ceil, floor, inf
from typing import Any

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.geometry import Beam, Grid, Turntable, Vessel, centers, positive
from vamgpu.kernels.proof import average_voxels, expose_voxels, spans, spread_columns, spread_rows, whole_and_part
from vamgpu.metrics.histogram import extremes
from vamgpu.metrics.parts import IN, Parts
from vamgpu.operators.projection import Projection
from vamgpu.optics.traced_pose import TracedPose, trace_pose
from vamgpu.optics.traced_rays import Rays, resin_radius, traced_rays
from vamgpu.printing.outer import Outer, corner_of, greatest_beyond
from vamgpu.printing.spread import TAIL, column_shares, row_shares, spread_of

MEMORY = 1 << 29
"""Bytes that the arrays of one slab may take."""
MEAN = np.array([3.0, -22.0, 125.0, 300.0, 125.0, -22.0, 3.0]) / 512.0
"""The mean over a voxel from voxels half as wide about its center and its faces, exact for polynomials of degree 5:
what their running integral, interpolated to the voxel's faces, gains between them."""
EDGE = len(MEAN) // 2
LANES = 64
"""Slices that tables are padded to: no device has wider vectors."""
SAMPLES = 128, 256
"""Fewest and most samples of a table of one pose from the axis to the wall, else one a part voxel. With 128 the dose
inside the printable radius is right to 7e-4, and beyond it, where caustics are, to 3 % (256: 1 %) voxel by voxel."""
STRAIGHT = 4
"""Samples of a table of straight light, which is exact between them."""
FAR = 2.0
"""Where resin reaches this much farther than the corners of the grid, it is exposed on wider voxels beyond them."""


@dataclass(frozen=True, eq=False)
class FineSlab:
    """Some slices of the dose on voxels half as wide as the part's.

    dose: [x, y, z] on the device, in units of Aᵀ(light): comparable with the dose of a part voxel.  x, y, z: centers of
    the voxels [mm].  pitch: their edge [mm].  radius: of the resin [mm]; voxels farther from the axis mean nothing.
    """

    dose: DeviceArray
    x: np.ndarray
    y: np.ndarray
    z: np.ndarray
    pitch: float
    radius: float


class IndependentExposure:
    """The light of a projection's pixels in the resin, by rays traced for it.

    Args:
        A: gives the geometry: grid, beam, motion and vessel; none of its tables is read.
        memory: bytes that the arrays of some slices may take. As many slices as the device keeps together (64 at most)
            are exposed in any case.

    Raises:
        BadInput: no ray reaches the resin.
    """

    grid: Grid
    beam: Beam
    motion: Turntable
    vessel: Vessel | None
    device: Device
    pitch: float
    memory: int

    def __init__(self, A: Projection, memory: int = MEMORY) -> None:
        self.grid, self.beam, self.motion, self.vessel, self.device = A.grid, A.beam, A.motion, A.vessel, A.device
        self.pitch, self.memory = 0.5 * A.grid.pitch, memory
        self.corner: float = corner_of(A.grid)
        wall = resin_radius(A.vessel)
        self.radius: float = self.corner if wall == inf else wall
        self._spread = spread_of(A.beam)
        self._discs: dict[tuple[float, float], _Disc] = {}

    # ---- what is asked ----------------------------------------------------------------------------------------------
    def fine(self, light: DeviceArray, reach: float | None = None) -> Iterator[FineSlab]:
        """The dose of light on voxels half as wide as the part's, slab by slab from the lowest z.

        A beam of a single row stands for a print that is the same at every height: there the two halves of a slice get
        the mean over it, and no voxel lies on its faces.

        Args:
            light: of every pixel [angle, r, z], a field on the device.
            reach: farthest from the axis [mm] that is exposed; the inner wall by default.

        Returns:
            Slabs that follow each other without a gap; let each go before the next one is asked for.

        Raises:
            BadInput: reach is no finite number above 0.
        """
        far, slices = self.radius if reach is None else positive("reach [mm]", reach), self.grid.shape[2]
        disc = self._disc(self.pitch, min(far, self.radius))
        if self.beam.flat:
            return self._fine(disc, light, centers(2 * slices, self.pitch), np.repeat(self.grid.axes()[2], 2))
        z = centers(2 * slices + 1, self.pitch)
        return self._fine(disc, light, z, z)

    def _fine(self, disc: _Disc, light: DeviceArray, z: np.ndarray, lit: np.ndarray) -> Iterator[FineSlab]:
        """Slabs of voxels at ``z``, with the dose of those at ``lit``."""
        height = self.grid.pitch if self.beam.flat else self.pitch
        for part in self._slabs(disc, z.size):
            dose = self._expose(disc, light, lit[part], height)
            yield FineSlab(dose, disc.axis, disc.axis, z[part], self.pitch, disc.radius)

    def averaged(
        self, light: DeviceArray, progress: Callable[[float], None] = lambda share: None
    ) -> tuple[DeviceArray, Outer | None]:
        """The dose on the part's own voxels, the mean of the fine ones.

        Along z the mean over a slice is that of its halves, whatever they are, so it is taken in one step.

        Args:
            light: of every pixel [angle, r, z], a field on the device.
            progress: is told the share of the slices that is done, slab by slab.

        Returns:
            The dose [x, y, z] of the grid, and the greatest beyond the judged cylinder; None where nothing is there.
        """
        far, pitch, disc = self._is_far, self.grid.pitch, self._near
        around = self.grid if far else self._around
        beyond = self._above_and_below(light)
        dose, z, outer = self.device.empty(self.grid.shape), self.grid.axes()[2], None
        every = z.size + beyond.size
        for part, fine in self.onto(light, dose):
            if not far:
                outer = self._greatest(self._averaged(disc, fine, around), (*around.axes()[:2], z[part]), pitch, outer)
            progress(min(part.stop, z.size) / every)
        if far:
            outer = self._greatest(dose, self.grid.axes(), pitch, None)
        for part in self._slabs(disc, beyond.size):
            fine = self._expose(disc, light, beyond[part], pitch)
            outer = self._greatest(self._averaged(disc, fine, around), (*around.axes()[:2], beyond[part]), pitch, outer)
            progress((z.size + min(part.stop, beyond.size)) / every)
        return dose, self._farther(light, np.sort(np.concatenate([z, beyond])), outer) if far else outer

    def onto(self, light: DeviceArray, dose: DeviceArray) -> Iterator[tuple[slice, DeviceArray]]:
        """The dose on the part's own voxels alone, slab by slab.

        Args:
            light: of every pixel [angle, r, z], a field on the device.
            dose: takes the dose [x, y, z] of the slices of a slab before that is told.

        Returns:
            Slices of the grid, the last of which may go on beyond it, and their dose on voxels half as wide.
        """
        disc, pitch = self._near, self.grid.pitch
        for part in self._slabs(disc, self.grid.shape[2]):
            z = self.grid.axes()[2][0] + np.arange(part.start, part.stop) * pitch
            fine = self._expose(disc, light, z, pitch)
            self._average(disc, fine, dose, part.start)
            yield part, fine

    def back(self, slope: np.ndarray) -> np.ndarray:
        """The transpose of `onto`, on the host in float64.

        Args:
            slope: derivatives by the dose on the part's voxels [x, y, z].

        Returns:
            Derivatives by the light [angle, r, z].
        """
        disc, tables, (nx, ny, nz) = self._near, self._tables, self.grid.shape
        matrices = (_averaging(n, disc) for n in (nx, ny))
        fine = np.einsum("xu,yv,xyz->uvz", *matrices, slope, optimize=True)
        poses, shares = (tables[name].numpy().astype(np.float64) for name in ("poses", "shares"))
        pose = {key: value for key, value in disc.pose.items() if key != "pose"} | {"radius": float(disc.half)}
        found = spans(poses, disc.pose["pose"].numpy().astype(np.float64), **pose, shape=fine.shape[:2])
        total = np.zeros((len(poses), len(shares) + 1, nz))
        for angle, lit, low, high, weight in found:
            total[angle] += _gathered(total.shape[1], low, high, weight).T @ fine[lit]
        profile = np.cumsum(total[:, :0:-1], axis=1)[:, ::-1]
        matrix = np.zeros((len(shares), self.beam.pixels[0]))
        matrix[np.arange(len(shares))[:, None], tables["first"].numpy()[:, None] + np.arange(shares.shape[1])] = shares
        spread = matrix.T @ profile
        rows = row_shares(self._spread, self.beam, self.grid.axes()[2], self.grid.pitch, LANES)
        return spread @ np.asarray(rows.shares)[:, :nz].T

    @property
    def _is_far(self) -> bool:
        return self.radius > FAR * self.corner

    @cached_property
    def _near(self) -> _Disc:
        """The fine voxels that the part's own are the mean of."""
        return self._disc(self.pitch, self.corner if self._is_far else self.radius)

    def _above_and_below(self, light: DeviceArray) -> np.ndarray:
        """Slices [mm] beyond the grid that rows with any light reach; none where one row stands for every height."""
        lit = np.flatnonzero(extremes(Parts.whole(light), per_slice=True).greatest[:, IN] > 0)
        if self.beam.flat or not lit.size:
            return np.zeros(0)
        edges = lit[[0, -1]] + [0, 1] - 0.5 * self.beam.pixels[1] + TAIL * self._spread.row * np.array([-1, 1])
        low, high = edges * self.beam.pitch / self.grid.pitch + 0.5 * self.grid.shape[2]
        k = np.arange(floor(low + 1e-9), ceil(high - 1e-9))
        return self.grid.axes()[2][0] + k[(k < 0) | (k >= self.grid.shape[2])] * self.grid.pitch

    def _farther(self, light: DeviceArray, z: np.ndarray, outer: Outer | None) -> Outer | None:
        """`Outer` out to the wall, on voxels so wide that the whole vessel has no more than the grid has fine ones."""
        width = self.grid.pitch * ceil(0.5 * self.radius / self.corner)
        disc = self._disc(width, self.radius)
        for part in self._slabs(disc, z.size):
            dose = self._expose(disc, light, z[part], self.grid.pitch)
            outer = self._greatest(dose, (disc.axis, disc.axis, z[part]), width, outer)
        return outer

    # ---- tables -----------------------------------------------------------------------------------------------------
    @cached_property
    def _rays(self) -> Rays:
        reach = self._spread.reach(self.beam)
        # The few samples of straight light are joined by straight lines: they must not end where the beam does.
        return traced_rays(self.vessel, max(reach, 4.0 * self.corner) if self.vessel is None else reach)

    @cached_property
    def _tables(self) -> dict[str, Any]:
        """How a column's light falls on bins, and the poses."""
        columns, poses = column_shares(self._spread, self.beam, self._rays), self.motion.poses
        times = np.asarray(getattr(self.motion, "times", np.ones_like(poses)))
        return {
            "first": self.device.table(columns.first, "int32"),
            "shares": self.device.table(columns.shares),
            "poses": self.device.table(np.stack([np.cos(poses), np.sin(poses), times, 0.0 * times], axis=1)),
        }

    def _disc(self, width: float, radius: float) -> _Disc:
        """Voxels of a width about the axis, made once."""
        if (width, radius) not in self._discs:
            half = ceil(radius / width) + EDGE
            samples = min(max(round(self.radius / self.grid.pitch), SAMPLES[0]), SAMPLES[1])
            spacing = half * width / STRAIGHT if self.vessel is None else self.radius / samples
            traced = trace_pose(self._rays, width, half * width, spacing)
            table = self.device.table(self._in_bins(traced, width))
            scale, single = width / traced.spacing, traced.single / width
            self._discs[width, radius] = _Disc(width, half, radius, {"pose": table, "scale": scale, "single": single})
        return self._discs[width, radius]

    def _in_bins(self, traced: TracedPose, width: float) -> np.ndarray:
        """A voxel's bins, and its share such that even light of 1 gives voxel volume / pixel area, as Aᵀ does."""
        bins, beam = self._spread.bins, self.beam
        table = traced.table.copy()
        table[..., :2] = (table[..., :2] / beam.pitch + 0.5 * beam.pixels[0] + self._spread.beyond) * bins
        table[..., 2] *= self.grid.voxel_volume / beam.pixel_area * beam.pitch / (bins * width)
        return table

    # ---- slabs ------------------------------------------------------------------------------------------------------
    def _slabs(self, disc: _Disc, slices: int) -> Iterator[slice]:
        """Parts of the slices, as many in each, whose arrays fit the memory and whose layout is that of the whole.

        The last may go on beyond the slices.
        """
        each = self.motion.angles * (self.beam.pixels[0] + self._tables["first"].shape[0]) + 2 * disc.axis.size**2
        each *= self.device.real.itemsize
        lanes = self.device.lanes_for(slices) or 1
        count = slices if each * slices <= self.memory else max(self.memory // (each * lanes), 1) * lanes
        while count != slices and count > lanes and self.device.lanes_for(count) != self.device.lanes_for(slices):
            count -= lanes
        for first in range(0, slices, count or 1):
            yield slice(first, first + count)

    def _expose(self, disc: _Disc, light: DeviceArray, z: np.ndarray, height: float) -> DeviceArray:
        """Dose [x, y, z] of a disc's voxels at some z, the mean over ``height`` about each."""
        tables, device, (angles, columns, _) = self._tables, self.device, light.shape
        rows = row_shares(self._spread, self.beam, z, height, LANES)
        spread = device.empty((angles, columns, z.size))
        shares = {"shares": device.table(rows.shares), "span": device.table(rows.span, "int32")}
        device.launch(spread_rows, light=light, **shares, lanes=light, spread=spread)
        profile = device.empty((angles, tables["first"].shape[0], z.size))
        device.launch(spread_columns, spread=spread, first=tables["first"], shares=tables["shares"], profile=profile)
        dose = device.empty((disc.axis.size, disc.axis.size, z.size))
        pose = {"poses": tables["poses"], **disc.pose, "radius": float(disc.half)}
        device.launch(expose_voxels, profile=profile, **pose, dose=dose)
        return dose

    def _averaged(self, disc: _Disc, fine: DeviceArray, around: Grid) -> DeviceArray:
        """Mean of a disc's voxels over those of a grid, of as many slices."""
        volume = self.device.empty((*around.shape[:2], fine.shape[2]))
        self._average(disc, fine, volume, 0)
        return volume

    def _average(self, disc: _Disc, fine: DeviceArray, volume: DeviceArray, first: int) -> None:
        """Mean of a disc's voxels over twice as wide ones about the axis, into slices of ``volume`` from ``first``."""
        corner_x, corner_y = (disc.half - (n - 1) - EDGE for n in volume.shape[:2])
        corner = {"corner_x": corner_x, "corner_y": corner_y, "taps": self.device.table(MEAN)}
        self.device.launch(average_voxels, fine=fine, **corner, first=first, volume=volume)

    # ---- beyond the judged cylinder ---------------------------------------------------------------------------------
    @cached_property
    def _around(self) -> Grid:
        """The part's grid with as many more voxels as it takes to the wall."""
        more = (ceil(max(self.radius / self.grid.pitch - 0.5 * n, 0.0)) for n in self.grid.shape[:2])
        nx, ny = (n + 2 * m for n, m in zip(self.grid.shape[:2], more, strict=True))
        return Grid((nx, ny, self.grid.shape[2]), self.grid.pitch)

    def _greatest(
        self, dose: DeviceArray, axes: tuple[np.ndarray, ...], width: float, best: Outer | None
    ) -> Outer | None:
        return greatest_beyond(self.grid, self.radius, dose, axes, width, best)


@dataclass(frozen=True, eq=False)
class _Disc:
    """Voxels ``width`` [mm] wide about the axis, ``half`` to either side, and what a launch says of one pose."""

    width: float
    half: int
    radius: float
    pose: dict[str, Any]

    @cached_property
    def axis(self) -> np.ndarray:
        """Centers of the voxels along x and along y [mm]."""
        return centers(2 * self.half + 1, self.width)


def _averaging(count: int, disc: _Disc) -> np.ndarray:
    """Weights of fine voxels in the part's, (count, fine), along x or along y."""
    matrix, corner = np.zeros((count, disc.axis.size)), disc.half - (count - 1) - EDGE
    for tap, weight in enumerate(MEAN):
        at = corner + 2 * np.arange(count) + tap
        inside = (at >= 0) & (at < disc.axis.size)
        matrix[np.flatnonzero(inside), at[inside]] = weight
    return matrix


def _gathered(count: int, low: np.ndarray, high: np.ndarray, weight: np.ndarray) -> Any:
    """Weights of a running integral's samples in the light between bins, (voxels, count)."""
    voxel, parts = np.arange(low.size), []
    for place, sign in ((low, -1.0), (high, 1.0)):
        k, part = whole_and_part(count, place)
        parts += [(sign * weight * (1.0 - part), k), (sign * weight * part, k + 1)]
    values, bins = (np.concatenate(column) for column in zip(*parts, strict=True))
    from scipy.sparse import csr_array

    return csr_array((values, (np.tile(voxel, 4), bins)), (low.size, count))

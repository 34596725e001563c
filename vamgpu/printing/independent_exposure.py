"""Exposure of frames that is independent of the solver's operator, of which only the geometry is used: traced rays,
which may meet at caustics, turn over the arc of a lit frame, on voxels at most half as wide as the part's.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from copy import copy
from dataclasses import dataclass
from functools import cached_property, partial
from math import ceil, floor, inf, sqrt
from typing import Any

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.geometry import Beam, Grid, Turntable, Vessel, centers, positive, resin_radius
from vamgpu.kernels.proof import average_voxels, expose_voxels, spans, spread_columns, spread_rows
from vamgpu.metrics.histogram import extremes
from vamgpu.metrics.parts import IN, Parts
from vamgpu.operators.compose import combine
from vamgpu.operators.follow import Followed, followed
from vamgpu.operators.projection import Projection
from vamgpu.operators.shifts import Shift
from vamgpu.optics.traced_pose import trace_pose
from vamgpu.optics.traced_rays import Rays, traced_rays
from vamgpu.printing.beyond_cylinder import Around, Outer, corner_of, greatest_beyond
from vamgpu.printing.spread import TAIL, column_shares, row_shares, spread_of

MEMORY, GPU_MEMORY = 1 << 29, 1 << 31
"""Bytes that the arrays of one slab may take; on a GPU, four slabs of `expose_voxels` take the time of one."""
BETWEEN = np.array([3.0, -25.0, 150.0, 150.0, -25.0, 3.0]) / 256.0
"""Interpolates midway between samples, exactly for polynomials of degree 5."""
A_PIXEL = 2.0
"""Smallest number of fine voxels across a column in the resin at the start, if the part's voxels are their mean."""
AGREED = 1e-3  # change of the dose, as a share of the greatest, at which refinement of the voxels stops
TRIES = 4  # greatest number of refinements: without a point spread, light has edges that no voxel resolves
HARDEST = 4  # number of slices to compare: the brightest one in each equal part of the height
BEND = 0.02
"""Column widths by which a path may bend at the corners of the grid and still count as straight while a frame is lit:
the dose is then right to 1e-3 of the greatest."""
EDGE = 3  # fine voxels beyond a grid's corner that the means over its voxels may need
STEPS = 2
"""Steps of a pixel at which the light of a part that travels is exposed; each takes as long as that of one at rest."""
LANES = 64  # tables are padded to a multiple of this number of slices: no device has wider vectors
SAMPLES = 128, 256
"""Fewest and most samples, from the axis to the wall, of a table of one angle; in between, one per part voxel. With
128, the dose is right to 7e-4 inside the printable radius, and to 3 % (256: 1 %) per voxel at caustics beyond it."""
STRAIGHT = 4  # samples of a table of straight light; light is linear between them
FAR = 2.0
"""If resin reaches this many times as far as the corners of the grid, wider voxels are used beyond the corners."""


@dataclass(frozen=True, eq=False)
class FineSlab:
    """Some slices of the dose on voxels finer than the part's."""

    # x, y, z: centers of the voxels [mm].

    dose: DeviceArray  # [x, y, z] on the device, in units of Aᵀ(light): comparable with the dose of a part voxel
    x: np.ndarray
    y: np.ndarray
    z: np.ndarray
    pitch: float  # their edge [mm]
    radius: float  # of the resin [mm]; ignore voxels farther from the axis


class IndependentExposure:
    """The light of a projection's pixels in the resin, from independent rays."""

    # A: gives the geometry (grid, beam, motion and vessel); its tables are not used.

    grid: Grid
    beam: Beam
    motion: Turntable  # the arcs of the light; by default those of the projection
    vessel: Vessel | None
    device: Device
    # fine voxels along an edge of a part voxel, at least 2; a part voxel is their mean. By default, enough for
    # `A_PIXEL` of them across the narrowest column in the resin. See `agreed`
    pitch: float
    # bytes that the arrays of some slices may take. At least the slices that the device keeps together (at most 64) are
    # exposed at a time
    agrees: float | None
    """Change of the dose on the next finer voxels, relative to the greatest dose; None before `agreed`."""

    def __init__(self, A: Projection, memory: int = 0, finer: int | None = None, motion: Any = None) -> None:
        self.grid, self.beam, self.vessel, self.device = A.grid, A.beam, A.vessel, A.device
        self.motion = A.motion if motion is None else motion
        members = len(getattr(A.device, "members", (A.device,)))
        self.memory: int = memory or (members * GPU_MEMORY if A.device.is_gpu else MEMORY)
        self.corner: float = corner_of(A.grid)
        wall = resin_radius(A.vessel)
        self.radius: float = self.corner if wall == inf else wall
        self._spread = spread_of(A.beam)
        self.finer: int = finer or max(2, ceil(A_PIXEL * A.grid.pitch / self.column))
        self.pitch, self.agrees = A.grid.pitch / self.finer, None
        self._discs: dict[tuple[float, float], _Disc] = {}
        self._bins: dict[int, dict[str, DeviceArray]] = {}
        self._path: Followed | None = followed(A.motion, A.beam)

    def agreed(self, light: DeviceArray) -> IndependentExposure:
        """The same on voxels so fine that finer ones change the dose of a given light by at most `AGREED`."""
        # light [angle, r, z]
        z, lit, judge = self._hardest(light), self.grid.cylinder(), self
        dose = judge._at(light, z)
        for finer in range(self.finer + 1, self.finer + TRIES + 1):
            following = copy(judge)
            following.finer, following.pitch, following._discs = finer, self.grid.pitch / finer, {}
            following.__dict__.pop("_near", None)
            found = following._at(light, z)
            judge.agrees = float(np.abs(found - dose)[lit].max() / (found[lit].max() or 1.0))
            if judge.agrees <= AGREED or finer == self.finer + TRIES:
                break
            judge, dose = following, found
        return judge

    def _hardest(self, light: DeviceArray) -> np.ndarray:
        """Slices [mm] of the grid in which dose is compared."""
        bright, z = extremes(Parts.whole(light), per_slice=True).greatest[:, IN], self.grid.axes()[2]
        row = np.clip(np.round(z / self.beam.pitch + 0.5 * (bright.size - 1)).astype(int), 0, bright.size - 1)
        return np.array([part[np.argmax(bright[row[part]])] for part in np.array_split(np.arange(z.size), HARDEST)
                         if part.size]) * self.grid.pitch + z[0]  # fmt: skip

    def _at(self, light: DeviceArray, z: np.ndarray) -> np.ndarray:
        """Dose [x, y, z] on the part's voxels at some z [mm], right in the judged cylinder."""
        disc = self._disc(self.pitch, self.grid.inscribed_radius + 2.0 * self.grid.pitch)
        return self._averaged(disc, self._expose(disc, light, z, self.grid.pitch), self.grid).numpy()

    def fine(self, light: DeviceArray, reach: float | None = None, above: float = 0.0) -> Iterator[FineSlab]:
        """The dose of light on voxels that are at most half as wide as the part's and as a column in the resin."""
        # Slabs are in order, from the lowest z. A beam of a single row represents a print that is the same at every
        # height: all fine voxels of a slice get the slice's mean, and no voxel lies on its faces. light [angle, r, z];
        # reach [mm]; above: height above and depth below the grid [mm]
        far, slices = self.radius if reach is None else positive("reach [mm]", reach), self.grid.shape[2]
        disc = self._disc(self.grid.pitch / self.halves, min(far, self.radius))
        if self.beam.flat:
            lit = np.repeat(self.grid.axes()[2], self.halves)
            return self._fine(disc, light, centers(lit.size, disc.width), lit)
        z = centers(self.halves * slices + 1 + 2 * ceil(above / disc.width), disc.width)
        return self._fine(disc, light, z, z)

    def _fine(self, disc: _Disc, light: DeviceArray, z: np.ndarray, lit: np.ndarray) -> Iterator[FineSlab]:
        """Slabs of voxels at ``z``, with the dose of those at ``lit``."""
        height = self.grid.pitch if self.beam.flat else disc.width
        for part in self._slabs(disc, z.size):
            dose = self._expose(disc, light, lit[part], height)
            yield FineSlab(dose, disc.axis, disc.axis, z[part], disc.width, disc.radius)

    def averaged(
        self, light: DeviceArray, progress: Callable[[float], None] = lambda share: None, part: Around | None = None
    ) -> tuple[DeviceArray, Outer | None]:
        """The dose on the part's own voxels, as means of the fine ones, and the greatest dose away from the part."""
        # Along z, the mean over a slice does not depend on its division; it is computed in one step.
        # light [angle, r, z]; returns [x, y, z]
        far, pitch, disc = self._is_far, self.grid.pitch, self._near
        around = self.grid if far else self._around
        beyond, greatest = self._above_and_below(light), partial(greatest_beyond, self.grid, self.radius, around=part)
        dose, z, outer = self.device.empty(self.grid.shape), self.grid.axes()[2], None
        every = z.size + beyond.size
        for some, fine in self.onto(light, dose):
            if not far:
                outer = greatest(self._averaged(disc, fine, around), (*around.axes()[:2], z[some]), pitch, outer)
            progress(min(some.stop, z.size) / every)
        if far:
            outer = greatest(dose, self.grid.axes(), pitch, None)
        for some in self._slabs(disc, beyond.size):
            fine = self._expose(disc, light, beyond[some], pitch)
            outer = greatest(self._averaged(disc, fine, around), (*around.axes()[:2], beyond[some]), pitch, outer)
            progress((z.size + min(some.stop, beyond.size)) / every)
        return dose, self._farther(light, np.sort(np.concatenate([z, beyond])), outer, greatest) if far else outer

    def onto(self, light: DeviceArray, dose: DeviceArray) -> Iterator[tuple[slice, DeviceArray]]:
        """The dose only on the part's own voxels, slab by slab."""
        # light [angle, r, z]; dose [x, y, z], whose slices divide the height of the grid
        disc, slices = self._near, dose.shape[2]
        height = self.grid.pitch * self.grid.shape[2] / slices
        for part in self._slabs(disc, slices):
            z = centers(slices, height)[0] + np.arange(part.start, part.stop) * height
            fine = self._expose(disc, light, z, height)
            self._average(disc, fine, dose, part.start)
            yield part, fine

    def back(self, slope: np.ndarray) -> np.ndarray:
        """The transpose of `onto`, on the host in float64."""
        # slope [x, y, z]; returns [angle, r, z]
        disc, tables, (nx, ny, nz) = self._near, self._tables, self.grid.shape
        matrices = (self._averaging(n, disc) for n in (nx, ny))
        fine = np.einsum("xu,yv,xyz->uvz", *matrices, slope, optimize=True)
        poses, shares = (tables[name].numpy().astype(np.float64) for name in ("poses", "shares"))
        pose = {key: value for key, value in disc.pose.items() if key != "pose"} | {"radius": float(disc.half)}
        profile = np.zeros((self.motion.angles, len(shares), nz))
        of = poses, disc.pose["pose"].numpy().astype(np.float64)
        for angle, lit, bins, weights in spans(*of, **pose, profile=profile.shape, shape=fine.shape[:2]):
            profile[angle] += _gathered(bins, weights, len(shares)).T @ fine[lit]
        matrix = np.zeros((len(shares), self.beam.pixels[0]))
        matrix[np.arange(len(shares))[:, None], tables["first"].numpy()[:, None] + np.arange(shares.shape[1])] = shares
        spread = matrix.T @ profile
        rows = row_shares(self._spread, self.beam, self.grid.axes()[2], self.grid.pitch, LANES)
        return spread @ np.asarray(rows.shares)[:, :nz].T

    @cached_property
    def column(self) -> float:
        """Width of the narrowest judged column in the resin [mm]."""
        across = self._rays.cross(0.0).across
        widths = np.abs(np.diff(across) / np.diff(self._rays.u))[np.abs(across[1:]) <= self.grid.inscribed_radius]
        return self.beam.pitch * float(widths.min(initial=1.0))

    @property
    def halves(self) -> int:
        """Voxels of `fine` along an edge of the part's."""
        return max(2, ceil(2.0 * self.grid.pitch / self.column - 0.1))

    @property
    def _is_far(self) -> bool:
        return self.radius > FAR * self.corner

    @cached_property
    def _near(self) -> _Disc:
        """The fine voxels whose means are the part's own voxels."""
        return self._disc(self.pitch, self.corner if self._is_far else self.radius)

    def _above_and_below(self, light: DeviceArray) -> np.ndarray:
        """Slices [mm] beyond the grid that rows with any light reach; none if one row represents every height."""
        lit = np.flatnonzero(extremes(Parts.whole(light), per_slice=True).greatest[:, IN] > 0)
        if self.beam.flat or not lit.size:
            return np.zeros(0)
        left = np.zeros(1) if self._path is None else self._path.left[..., 1]
        tails = TAIL * self._spread.row * np.array([-1, 1]) + [left.min(), left.max()]
        edges = lit[[0, -1]] + [0, 1] - 0.5 * self.beam.pixels[1] + tails
        low, high = edges * self.beam.pitch / self.grid.pitch + 0.5 * self.grid.shape[2]
        k = np.arange(floor(low + 1e-9), ceil(high - 1e-9))
        return self.grid.axes()[2][0] + k[(k < 0) | (k >= self.grid.shape[2])] * self.grid.pitch

    def _farther(self, light: DeviceArray, z: np.ndarray, outer: Outer | None, greatest: Any) -> Outer | None:
        """`Outer` out to the wall, on voxels wide enough that the vessel has no more than the grid has fine ones."""
        width = self.grid.pitch * ceil(0.5 * self.radius / self.corner)
        disc = self._disc(width, self.radius)
        for part in self._slabs(disc, z.size):
            dose = self._expose(disc, light, z[part], self.grid.pitch)
            outer = greatest(dose, (disc.axis, disc.axis, z[part]), width, outer)
        return outer

    @cached_property
    def _rays(self) -> Rays:
        reach = self._spread.reach(self.beam)
        # Straight light has few samples, joined by straight lines: they must not end where the beam ends.
        return traced_rays(self.vessel, max(reach, 4.0 * self.corner) if self.vessel is None else reach)

    @cached_property
    def _tables(self) -> dict[str, Any]:
        """Shares of a column's light in bins, and the angles."""
        return {**self._columns(0), "poses": self.device.table(self._arcs)}

    def _columns(self, off: int) -> dict[str, DeviceArray]:
        """First column and shares of every bin, for light moved by ``off`` bins."""
        if off not in self._bins:
            columns = column_shares(self._spread, self.beam, self._rays)
            own = np.arange(len(columns.first)) - off
            inside, own = (own >= 0) & (own < own.size), np.clip(own, 0, own.size - 1)
            shares = self.device.table(columns.shares[own] * inside[:, None])
            self._bins[off] = {"first": self.device.table(columns.first[own], "int32"), "shares": shares}
        return self._bins[off]

    @property
    def _arcs(self) -> np.ndarray:
        """Cosine, sine, time and half turn of arcs that are short enough for straight motion."""
        poses = self.motion.poses
        times, arcs = (np.asarray(getattr(self.motion, name, or_else * np.ones_like(poses)))
                       for name, or_else in (("times", 1.0), ("arcs", 0.0)))  # fmt: skip
        straight = sqrt(8.0 * BEND * self.column / min(self.corner, self.radius))
        count = max(ceil(arcs.max() / straight), 1)
        at = (poses[:, None] + (centers(count, 1.0 / count) * arcs[:, None])).ravel()
        times, half = np.repeat(times / count, count), np.repeat(0.5 * arcs / count, count)
        return np.stack([np.cos(at), np.sin(at), times, half], axis=1)

    def _disc(self, width: float, radius: float) -> _Disc:
        """Voxels of a width about the axis, made once."""
        if (width, radius) not in self._discs:
            half = ceil(radius / width) + EDGE
            samples = min(max(round(self.radius / self.grid.pitch), SAMPLES[0]), SAMPLES[1])
            spacing = half * width / STRAIGHT if self.vessel is None else self.radius / samples
            traced = trace_pose(self._rays, width, half * width, spacing)
            table, bins, beam = traced.table.copy(), self._spread.bins, self.beam
            table[..., :2] = (table[..., :2] / beam.pitch + 0.5 * beam.pixels[0] + self._spread.beyond) * bins
            # its share, scaled as in Aᵀ: uniform light of 1 gives voxel volume / pixel area
            table[..., 2] *= self.grid.voxel_volume / beam.pixel_area * beam.pitch / (bins * width)
            scale, single = width / traced.spacing, traced.single / width
            self._discs[width, radius] = _Disc(
                width, half, radius, {"pose": self.device.table(table), "scale": scale, "single": single}
            )
        return self._discs[width, radius]

    def _slabs(self, disc: _Disc, slices: int) -> Iterator[slice]:
        """Equal parts of the slices, with arrays that fit the memory, in the layout of the whole."""
        # The last part may extend beyond the slices.
        each = self.motion.angles * (self.beam.pixels[0] + self._tables["first"].shape[0]) + 2 * disc.axis.size**2
        each *= self.device.real.itemsize
        lanes = self.device.lanes_for(slices) or 1
        slabs, some = max(self.memory // (each * lanes), 1), expose_voxels.gpu.slabs
        count = slices if each * slices <= self.memory else (slabs - (slabs % some if slabs > some else 0)) * lanes
        while count != slices and count > lanes and self.device.lanes_for(count) != self.device.lanes_for(slices):
            count -= lanes
        for first in range(0, slices, count or 1):
            yield slice(first, first + count)

    def _expose(self, disc: _Disc, light: DeviceArray, z: np.ndarray, height: float) -> DeviceArray:
        """Dose [x, y, z] of a disc's voxels at given z, averaged over ``height`` about each z."""
        if self._path is None:
            return self._at_rest(disc, light, z, height, 0)
        still = Shift(self.device, np.zeros((light.shape[0], 2)), self.beam.pixels, self.beam.pixels)
        part, found = self.device.empty(light.shape), None
        for (bins, row), shares in self._path.in_steps(self._spread.bins, STEPS):
            shares = np.resize(shares * self._path.repeats / len(self._path.whole), (light.shape[0], shares.shape[1]))
            still.there(light, self.device.table(shares * np.ones((1, light.shape[2]))), part)
            dose = self._at_rest(disc, part, z - row / STEPS * self.beam.pitch, height, bins)
            found = dose if found is None else combine(1.0, found, 1.0, dose, found)
        assert found is not None
        return found

    def _at_rest(self, disc: _Disc, light: DeviceArray, z: np.ndarray, height: float, off: int) -> DeviceArray:
        """`_expose` for a part at rest, whose light is moved by ``off`` bins across."""
        tables, device, (angles, columns, _) = self._tables, self.device, light.shape
        rows = row_shares(self._spread, self.beam, z, height, LANES)
        spread = device.empty((angles, columns, z.size))
        shares = {"shares": device.table(rows.shares), "span": device.table(rows.span, "int32")}
        device.launch(spread_rows, light=light, **shares, lanes=light, spread=spread)
        profile = device.empty((angles, tables["first"].shape[0], z.size))
        device.launch(spread_columns, spread=spread, **self._columns(off), profile=profile)
        dose = device.empty((disc.axis.size, disc.axis.size, z.size))
        pose = {"poses": tables["poses"], **disc.pose, "radius": float(disc.half)}
        device.launch(expose_voxels, profile=profile, **pose, dose=dose)
        return dose

    def _averaged(self, disc: _Disc, fine: DeviceArray, around: Grid) -> DeviceArray:
        """Mean of a disc's voxels over those of a grid with the same slices."""
        volume = self.device.empty((*around.shape[:2], fine.shape[2]))
        self._average(disc, fine, volume, 0)
        return volume

    def _average(self, disc: _Disc, fine: DeviceArray, volume: DeviceArray, first: int) -> None:
        """Mean of a disc's voxels over the part's about the axis, written to slices of ``volume`` from ``first`` on."""
        corners, taps = zip(*(self._mean_of(n, disc) for n in volume.shape[:2]), strict=True)
        given = {"taps": self.device.table(np.stack(taps)), "corner_x": corners[0], "corner_y": corners[1]}
        self.device.launch(average_voxels, fine=fine, finer=self.finer, **given, first=first, volume=volume)

    def _mean_of(self, count: int, disc: _Disc) -> tuple[int, np.ndarray]:
        """The first fine voxel, and the weights of the mean over the first of ``count`` part voxels about the axis."""
        # The mean is the difference of the running integral of the fine voxels between its faces; if these lie in the
        # middle of fine voxels, the integral is interpolated.
        finer = self.finer
        split = BETWEEN if count * finer % 2 == 0 else np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
        return disc.half - (count * finer + 4) // 2, np.convolve(split, np.full(finer, 1.0 / finer))

    def _averaging(self, count: int, disc: _Disc) -> np.ndarray:
        """Weights of fine voxels in the part's, (count, fine), along x or along y."""
        matrix, (corner, taps) = np.zeros((count, disc.axis.size)), self._mean_of(count, disc)
        for tap, weight in enumerate(taps):
            at = corner + self.finer * np.arange(count) + tap
            inside = (at >= 0) & (at < disc.axis.size)
            matrix[np.flatnonzero(inside), at[inside]] = weight
        return matrix

    @cached_property
    def _around(self) -> Grid:
        """The part's grid, extended by whole voxels to the wall."""
        more = (ceil(max(self.radius / self.grid.pitch - 0.5 * n, 0.0)) for n in self.grid.shape[:2])
        nx, ny = (n + 2 * m for n, m in zip(self.grid.shape[:2], more, strict=True))
        return Grid((nx, ny, self.grid.shape[2]), self.grid.pitch)


@dataclass(frozen=True, eq=False)
class _Disc:
    """Voxels ``width`` [mm] wide about the axis, ``half`` to either side, and the launch arguments of one angle."""

    width: float
    half: int
    radius: float
    pose: dict[str, Any]

    @cached_property
    def axis(self) -> np.ndarray:
        """Centers of the voxels along x and along y [mm]."""
        return centers(2 * self.half + 1, self.width)


def _gathered(bins: np.ndarray, weights: np.ndarray, count: int) -> Any:
    """Weights of ``count`` bins in the light of voxels, (voxels, count)."""
    from scipy.sparse import csr_array

    voxel = np.repeat(np.arange(len(bins)), bins.shape[1])
    return csr_array((weights.ravel(), (voxel, bins.ravel())), (len(bins), count))

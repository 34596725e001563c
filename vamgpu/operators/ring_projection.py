"""Projection of a box of voxels that is computed on rings: one table of one angle for any number of angles."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property
from math import ceil, sqrt
from typing import Any, final

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.geometry import FULL_TURN, Beam, Grid, Turntable, Vessel, positive
from vamgpu.kernels.gather import gather_rows
from vamgpu.kernels.spectrum import ONE_SUM, ROWS
from vamgpu.kernels.stack import put_slices
from vamgpu.operators.compose import combine
from vamgpu.operators.linear import VoxelProjector
from vamgpu.operators.polar import PolarGrid
from vamgpu.operators.projection import Projection
from vamgpu.operators.ray_table import column_in_resin
from vamgpu.operators.ring_splines import TAPS, shares
from vamgpu.operators.row_resampler import RowResampler
from vamgpu.operators.space import VolumeSpace
from vamgpu.operators.spectral import SpectralProjection
from vamgpu.operators.traced_projection import BLOCK, WHOLE, SparseEntries
from vamgpu.operators.transforms import passes
from vamgpu.schema.quantities import finite

WIDTH, FINE = 0.75, 0.6
"""Width of a ring, the smaller of its ratios to a voxel and to a column of light in the resin. Windows of light found
by rays in a vial, with columns of 0.33 to 1.33 voxels in the resin, are the same on such rings within 0.001. On rings
of 0.75 voxels, they are lower by 0.1, 0.06, 0.04 and 0.007 for columns of 0.33, 0.5, 0.67 and 1 voxel."""
NARROWEST, WIDEST = 0.1, 2.0  # allowed widths: narrower rings are too many, wider ones lose a tenth of the dose
BEYOND = 2  # number of rings beyond those that voxels use: at the end of splines, light beyond affects this many rings
FAINT = 3e-4
"""Share of the table's greatest entry below which entries are dropped: up to 1/4 of the products, 3e-5 of a dose."""
AT_ONCE = {False: 1 << 30, True: 1 << 33}  # limit of its work fields [bytes], on processors and on GPUs
Others = Sequence[tuple[SpectralProjection, DeviceArray]]
THICK = 64  # strips have a multiple of this number of slices, the widest lanes, which share each entry of the table


@final
class RingProjection(VoxelProjector):
    """A `Projection` at evenly spaced angles, computed by Fourier transforms over the angles, on rings about the axis.

    It can replace a `Projection` everywhere, also in a vial. Its doses differ by at most 0.002 of the greatest dose
    (root mean square; 0.02 in any voxel) if light has a point spread, except within two voxels of the rim of the lit
    resin. Rings are 0.75 voxels or 0.6 columns wide. At their points, the dose is averaged over a voxel, or over the
    width of a column in the resin. Cubic splines interpolate it at the voxels in the cylinder that light reaches at
    every angle. Voxels beyond it count as unlit. Its transpose is exact. Prints are judged by independent rays, as for
    ``direct``. It keeps its work fields: three on rings, each at least 1.4 times a volume, and three of light. Slices
    are processed in strips that keep the fields below one gigabyte on processors and eight on GPUs.

    Args:
        grid: Voxels of the volume, an even number along z.
        beam: Pixels, with their fill factor and point spread.
        motion: Angles of the turntable, even over a full turn.
        vessel: For example a `Vial`; None for straight light.
        device: A name or a device; the best available one by default.
        rings: The rings, of the voxels' height; by default with the width given above.
        tf32: Use eleven bits of each number in products, as for `SpectralProjection`.

    Raises:
        BadInput: An argument is of another type, or rings do not support it.
        DeviceError: There is no such device.
    """

    def __init__(
        self,
        grid: Grid,
        beam: Beam,
        motion: Turntable,
        vessel: Vessel | None = None,
        device: str | Device | None = None,
        *,
        rings: PolarGrid | None = None,
        tf32: bool = False,
    ) -> None:
        self._set_geometry(grid, beam, motion, device)
        why = _unsupported(grid, motion)
        if why:
            raise BadInput(f"rings do not support this: {why}; use Projection, which takes the same arguments")
        self.vessel: Vessel | None = vessel
        self.tf32: bool = tf32
        width = _width(grid, beam, vessel)
        self.rings: PolarGrid = rings_of(grid, motion.angles, width) if rings is None else _fitting(rings, grid, motion)
        self._strips, slices = _strips(self.rings, beam, self.device)
        some = replace(self.rings, slices=slices)
        self._spectral = SpectralProjection(
            some,
            beam,
            vessel,
            self.device,
            square=grid.pitch / _parts(self.rings.pitch / grid.pitch),
            faint=FAINT,
            tf32=tf32,
            splines=True,
            motion=motion,
        )
        self._rows = RowResampler.of(beam, grid.shape[2], grid.pitch, self.device)
        found = in_voxels(self.rings, grid, vessel.lit_radius if vessel else np.inf)
        self._to_voxels = found.table(self.device, grid.shape[:2], BLOCK)
        self._to_rings = found.transposed().table(self.device, self.rings.shape[:2], BLOCK)
        if getattr(self.device, "memory", None) is not None:
            self._take_memory()

    @classmethod
    def of(cls, A: Projection, width: float | None = None, *, tf32: bool = False) -> RingProjection:
        """Compute a projection on rings, on its device.

        Args:
            A: The projection.
            width: Width of rings over that of voxels; wider ones are faster, and less exact. By default 0.75, or 0.6 of
                a column of light in the resin if that is less.
            tf32: Use eleven bits of each number in products, as for `SpectralProjection`.

        Returns:
            The projection on rings; its ``direct`` is ``A``.

        Raises:
            BadInput: Rings do not support it.
        """
        why = unsupported_reason(A)
        if why:
            raise BadInput(f"rings do not support this projector: {why}; use the projector itself")
        if width is None:
            width = _width(A.grid, A.beam, A.vessel)
        if not NARROWEST <= positive("width", width) <= WIDEST:
            raise BadInput(f"got width={width}; expected {NARROWEST} to {WIDEST} of a voxel, such as {WIDTH}")
        rings = rings_of(A.grid, A.motion.angles, width)
        found = cls(A.grid, A.beam, A.motion, A.vessel, A.device, rings=rings, tf32=tf32)
        found.direct = A
        return found

    def raised(self, height: float) -> RingProjection:
        """The same operator for light that is higher, with the same tables; its ``direct`` is not moved.

        Args:
            height: Distance by which it is higher [mm].

        Returns:
            The operator.
        """
        finite("height", height)
        other = copy(self)
        other._made = RingProjection.raised, (self, height)
        other._rows = RowResampler.of(self.beam, self.grid.shape[2], self.grid.pitch, self.device, height)
        return other

    def _thinned(self, slices: int) -> RingProjection:
        """The same operator for as many slices and rows, with the same tables, and without ``direct``."""
        other = copy(self)
        vars(other).pop("direct", None)
        other._spectral, other._strips = self._spectral._thinned(slices), range(1)
        other.grid, other.beam = replace(self.grid, shape=(*self.grid.shape[:2], slices)), other._spectral.beam
        other._set_spaces(VolumeSpace(other.grid), other._spectral.range, self.device)
        other._rows = other._spectral._rows
        return other

    @cached_property
    def direct(self) -> Projection:
        """The same operator, by rays through each voxel."""
        return Projection(self.grid, self.beam, self.motion, self.vessel, self.device)

    def described(self) -> dict[str, Any]:
        """Describe the constructor's arguments.

        Returns:
            Its arguments by name.
        """
        return {name: getattr(self, name) for name in ("grid", "beam", "motion", "vessel", "rings", "tf32")}

    def forward(self, x: DeviceArray, out: DeviceArray) -> None:
        self.forward_with(x, (), out)

    def transposed(self, y: DeviceArray, out: DeviceArray) -> None:
        self.transposed_with(y, out, ())

    def takes_with(self, cells: PolarGrid) -> bool:
        """Whether one transform of the light also serves the cells of other operators.

        Args:
            cells: The cells.

        Returns:
            True if all slices are processed at once.
        """
        own = self._spectral.grid
        same = (own.angles, own.slices) == (cells.angles, cells.slices) and len(self._strips) == 1
        return same and np.allclose(own.z, cells.z)

    def forward_with(self, x: DeviceArray, others: Others, out: DeviceArray) -> None:
        """Compute out = A x + the projections of the cells of other operators.

        Args:
            x: The operand, [x, y, z].
            others: Products on rings for which `takes_with` is true, and their cells.
            out: Receives the result, [angle, r, z].
        """
        with self._rows.filling(out, self._rows_field) as rows:
            for first in self._strips:
                on_rings = self._spectral._work("samples", self._spectral.grid.shape)
                self.device.launch(gather_rows, source=self._cut("voxels", x, first), **self._to_rings, out=on_rings)
                light = self._strip("light", rows)
                spectrum = self._spectral._gathered(on_rings)
                for other, cells in others:
                    combine(1.0, spectrum, 1.0, other._gathered(cells), spectrum)
                self._spectral._in_turn(spectrum, light)
                self._put(light, first, rows)

    def transposed_with(self, y: DeviceArray, out: DeviceArray, others: Others) -> None:
        """Compute out = Aᵀ y, and the cells of other operators, the transpose of `forward_with`.

        Args:
            y: The operand, [angle, r, z].
            out: Receives the result, [x, y, z].
            others: Products on rings for which `takes_with` is true, and the arrays for their cells.
        """
        rows = self._rows.in_slices(y, self._rows_field)
        for first in self._strips:
            on_rings = self._spectral._work("samples", self._spectral.grid.shape)
            spectrum = self._spectral._by_frequency(self._cut("light", rows, first))
            self._spectral._on_rings(spectrum, on_rings)
            for other, cells in others:
                other._on_rings(spectrum, cells)
            dose = self._strip("voxels", out)
            self.device.launch(gather_rows, source=on_rings, **self._to_voxels, out=dose)
            self._put(dose, first, out)

    def _take_memory(self) -> None:
        """Allocate the permanent work fields before any others, which may then have to be in files."""
        slices, (angles, columns, _) = self._spectral.grid.slices, self.range.shape
        work = self._spectral._work
        several = self._spectral._from_rings.count > 1
        for name in ("samples", "rings 0", *["rings 1"] * several):
            work(name, self._spectral.grid.shape)
        for name in ("light 0", *["light 1"] * (self._spectral._of_light.count > 1)):
            work(name, self._spectral._light_shape)
        if len(self._strips) > 1:
            work("light", (angles, columns, slices))
            work("voxels", (*self.grid.shape[:2], slices))

    @property
    def row_weights(self) -> np.ndarray:
        """Share of each pixel row's light that falls in each slice, (slices, rows)."""
        return self._rows.weights

    def _rows_field(self, shape: tuple[int, ...]) -> DeviceArray:
        return self._spectral._work("rows", shape)

    def _strip(self, name: str, of: DeviceArray) -> DeviceArray:
        """A field for the slices that are processed at a time; the field itself if those are all."""
        alone = len(self._strips) == 1
        return of if alone else self._spectral._work(name, (*of.shape[:2], self._spectral.grid.slices))

    def _cut(self, name: str, source: DeviceArray, first: int) -> DeviceArray:
        """Slices of a field from ``first`` on; slices beyond its last one are not changed."""
        strip = self._strip(name, source)
        if strip is not source:
            self._put(source, -first, strip)
        return strip

    def _put(self, strip: DeviceArray, first: int, field: DeviceArray) -> None:
        """Copy slices to a field, from ``first`` on, such as those of `_cut` back to theirs."""
        if strip is not field:
            given = {"first": first, "factor": 1.0, "keep": 0, "lanes": strip}
            self.device.launch(put_slices, source=strip, **given, stack=field)


def unsupported_reason(A: Any) -> str:
    """Reason why rings cannot replace an operator; empty if they can."""
    if isinstance(A, RingProjection):
        return "it is on rings already; RingProjection.of(A.direct, width=…) makes others"
    if not isinstance(A, Projection):
        return f"got a {type(A).__name__}; expected a Projection, with level light that is the same at every angle"
    return _unsupported(A.grid, A.motion)


def prefers_rings(A: Any) -> bool:
    """Whether rings support an operator and were measured to be faster."""
    # Measured from 48 voxels (128 on GPUs) and 90 angles on, with short transforms; not on one thread of Warp.
    is_gpu = getattr(A.device, "is_gpu", False)
    if unsupported_reason(A) or not (is_gpu or A.device.name.startswith("opencl")) or A.motion.angles < 90:
        return False
    if min(A.grid.shape[:2]) < (128 if is_gpu else 48):
        return False
    return max(passes([A.motion.angles], ONE_SUM.__ge__)[0]) <= ONE_SUM


def uneven_reason(motion: Turntable) -> str:
    """Reason why the light of one angle, rotated, is not that of all angles; empty if it is."""
    if motion.travel is not None:
        return "its part moves (travel), which rings do not follow; expected a part at rest, or voxels"
    even = motion.is_even and motion.angles >= 2
    return "" if even else f"its angles are {motion}; expected two or more, even over a full turn from 0, lit equally"


def _unsupported(grid: Grid, motion: Turntable) -> str:
    if why := uneven_reason(motion):
        return why
    if grid.shape[2] % 2:
        return f"got {grid.shape[2]} slices; expected an even number"
    return f"a slice has more than {WHOLE} voxels" if grid.shape[0] * grid.shape[1] > WHOLE else ""


def rings_of(grid: Grid, angles: int, width: float) -> PolarGrid:
    """Rings out to beyond the taps of the outermost voxel that light reaches at every angle."""
    count = _least(grid, width) + BEYOND
    return PolarGrid(-(-count // ROWS) * ROWS, grid.shape[2], width * grid.pitch, angles, grid.pitch)


def _width(grid: Grid, beam: Beam, vessel: Vessel | None) -> float:
    """Ratio of the width of rings to that of voxels that the light needs."""
    column = column_in_resin(beam, vessel) if vessel else beam.pitch
    return max(min(WIDTH, FINE * column / grid.pitch), NARROWEST)


def _parts(width: float) -> int:
    """Number of squares along a voxel's edge, about as wide as columns that need rings of this width."""
    return max(1, ceil(FINE / width - 0.25))


def _strips(rings: PolarGrid, beam: Beam, device: Device) -> tuple[range, int]:
    """First slices of the strips, which are processed one after another, and the number of slices of a strip."""
    angles, cells, slices = rings.shape
    each = 4 * angles * (3 * cells + 3 * beam.pixels[0])
    most = AT_ONCE[getattr(device, "is_gpu", False)] * len(getattr(device, "members", ".")) // each
    if slices <= max(most, THICK):
        return range(1), slices
    count = -(-slices // max(most // THICK * THICK, THICK))
    strip = -(-slices // (count * THICK)) * THICK
    return range(0, slices, strip), strip


def _fitting(rings: PolarGrid, grid: Grid, motion: Turntable) -> PolarGrid:
    if not isinstance(rings, PolarGrid):
        raise BadInput(f"got {rings!r} as rings; expected a PolarGrid, or None for rings as wide as light needs")
    if (rings.slices, rings.angles) != (grid.shape[2], motion.angles):
        raise BadInput(f"got {rings!r} for {grid!r} at {motion}; expected rings of the same angles and slices")
    if abs(rings.slice_pitch / grid.pitch - 1) > 1e-9:
        raise BadInput(
            f"got rings whose slices are {rings.slice_pitch:g} mm high for voxels of {grid.pitch:g} mm; "
            f"pass height={grid.pitch:g} to PolarGrid"
        )
    if not covers(rings, grid):
        raise BadInput(
            f"got {rings.rings} rings {rings.pitch:g} mm wide, which do not reach the outermost voxels; "
            f"expected {_least(grid, rings.pitch / grid.pitch)} or more for {grid!r}, a multiple of {ROWS}"
        )
    return rings


def covers(rings: PolarGrid, grid: Grid) -> bool:
    """Whether rings extend beyond all that are needed by the voxels that light reaches at every angle."""
    return rings.rings >= _least(grid, rings.pitch / grid.pitch)


def _least(grid: Grid, width: float) -> int:
    """Rings, of a width in voxels, out to the last tap of the outermost voxel that light reaches at every angle."""
    beyond = sqrt(0.5) * (1.0 - 1.0 / _parts(width))  # to the middle of its outermost square
    return ceil((0.5 * (min(grid.shape[:2]) - 1) + beyond) / width + TAPS[-1] + 0.5)


def in_voxels(rings: PolarGrid, grid: Grid, lit_radius: float) -> SparseEntries:
    """Weights of coefficients on rings in lit voxels: splines along the radius and along each of four rings."""
    x, y, _ = grid.axes()
    across, along = (each.ravel() for each in np.meshgrid(x, y, indexing="ij"))
    voxel = np.flatnonzero(grid.cylinder().ravel() & (np.hypot(across, along) <= lit_radius))
    parts = _parts(rings.pitch / grid.pitch)
    off = grid.pitch * ((np.arange(parts) + 0.5) / parts - 0.5)
    found = [
        _at_points(rings, across[voxel] + right, along[voxel] + up) for right in off.tolist() for up in off.tolist()
    ]
    row, column, weight = (np.concatenate(each) for each in zip(*found, strict=True))
    return SparseEntries(voxel[row].astype(np.int32), column.astype(np.int32), weight.astype(np.float32))


def _at_points(rings: PolarGrid, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Numbers of points and cells, and weights, of the taps of points; points beyond the rings are dark."""
    radius, turn = np.hypot(x, y) / rings.pitch - 0.5, np.arctan2(y, x) / FULL_TURN
    inside = np.flatnonzero(radius + TAPS[-1] < rings.rings)
    radius, turn = radius[inside], turn[inside]
    bands = [band for band in rings.bands for _ in range(band.rings)]
    samples, wide, first = (np.array(each) for each in zip(
        *((b.samples, b.rings, b.cell - b.begin) for b in bands), strict=True))  # fmt: skip
    low = np.floor(radius).astype(int)
    rows, columns, weights = [], [], []
    for tap, radial in zip(TAPS, shares(radius - low), strict=True):
        ring = low + tap
        beyond = ring < 0  # across the axis, half a turn on
        ring = np.where(beyond, -1 - ring, ring)
        count = samples[ring] * rings.angles
        place = np.mod(turn + 0.5 * beyond, 1.0) * count
        start = np.floor(place).astype(int)
        for step, tangential in zip(TAPS, shares(place - start), strict=True):
            angle, cell = np.divmod((start + step) % count, samples[ring])
            rows.append(inside)
            columns.append(angle * rings.shape[1] + first[ring] + cell * wide[ring] + ring)
            weights.append(radial * tangential)
    return np.concatenate(rows), np.concatenate(columns), np.concatenate(weights)

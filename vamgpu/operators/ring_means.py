"""Means between voxels of a box and cells of rings, each way an operator with its exact transpose."""

from __future__ import annotations

from dataclasses import replace
from math import pi
from typing import TYPE_CHECKING, final

import numpy as np

from vamgpu.backend import open_device
from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.geometry import Grid
from vamgpu.kernels.gather import gather_rows
from vamgpu.operators.linear import LinearOperator
from vamgpu.operators.polar import PolarGrid
from vamgpu.operators.row_resampler import RowResampler
from vamgpu.operators.space import PolarSpace, VolumeSpace, require_kinds
from vamgpu.operators.traced import WHOLE, SparseEntries

if TYPE_CHECKING:
    from scipy.sparse import csr_array

POINTS, GENERATOR = 89, 55
"""Points of a cell that stand for equal parts of its area, a Fibonacci lattice: one in each of 89 rows and columns."""
BLOCK = 1 << 24
"""Columns of the matrix that are read together."""


def shares_of_voxels(rings: PolarGrid, shape: tuple[int, int], pitch: float) -> csr_array:
    """Share of every cell in each column of voxels, (angles · cells, x · y) float32, by `POINTS` points."""
    from scipy.sparse import csr_array, vstack

    blocks = [_of_band(rings, number, shape, pitch) for number in range(len(rings.bands))]
    whole = csr_array(vstack(blocks))
    cells, at, sizes = rings.shape[1], [], 0
    for band in rings.bands:  # rows come band by band; volumes hold the bands of an angle together
        own = band.rings * band.samples
        at.append(sizes + np.arange(rings.angles * own).reshape(rings.angles, own))
        sizes += rings.angles * own
    order = np.concatenate(at, axis=1).reshape(rings.angles * cells)
    return csr_array(whole[order])


def _of_band(rings: PolarGrid, number: int, shape: tuple[int, int], pitch: float) -> csr_array:
    """Rows of the cells of a band, [angle, cell of the band]."""
    from scipy.sparse import csr_array

    band = rings.bands[number]
    count = rings.angles * band.samples
    u, v = (np.arange(POINTS) + 0.5) / POINTS, (np.arange(POINTS) * GENERATOR % POINTS + 0.5) / POINTS
    inner = np.arange(band.begin, band.stop)[:, None]
    rho = np.sqrt(inner**2 + u * (2 * inner + 1)) * (rings.pitch / pitch)  # equal parts of the area
    turn = 2.0 * pi / count * (np.arange(count)[:, None] + v - 0.5)
    x, y = (np.floor(f(turn)[:, None, :] * rho + 0.5 * n).astype(np.int32)
            for f, n in ((np.cos, shape[0]), (np.sin, shape[1])))  # fmt: skip
    inside = (x >= 0) & (x < shape[0]) & (y >= 0) & (y < shape[1])
    places = x * shape[1] + y
    row = np.broadcast_to(np.arange(count * band.rings).reshape(count, band.rings, 1), places.shape)
    weight = np.full(int(inside.sum()), 1.0 / POINTS, np.float32)
    found = csr_array((weight, (row[inside], places[inside])), shape=(count * band.rings, shape[0] * shape[1]))
    found.sum_duplicates()
    return found


class _Means(LinearOperator):
    """Base of both ways: one matrix for all slices, by rows and by columns, and a resampling along z."""

    grid: Grid
    rings: PolarGrid

    def __init__(self, grid: Grid, rings: PolarGrid, device: str | Device | None) -> None:
        require_kinds(f"{type(self).__name__} takes both", (grid, Grid), (rings, PolarGrid))
        most = max(grid.shape[0] * grid.shape[1], rings.shape[0] * rings.shape[1])
        if most > WHOLE:
            raise BadInput(f"a slice has {most} voxels or cells; expected {WHOLE} at most: use a coarser geometry")
        self.grid, self.rings = grid, rings
        self.device: Device = open_device(device)
        self._slices = RowResampler(grid.shape[2], grid.pitch, rings.slices, rings.slice_pitch, self.device)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.grid!r}, {self.rings!r}, device={self.device.name!r})"

    def _shares(self) -> SparseEntries:
        """Shares of voxels (columns) in cells (rows)."""
        found = shares_of_voxels(self.rings, self.grid.shape[:2], self.grid.pitch).tocoo()
        return SparseEntries(found.row.astype(np.int32), found.col.astype(np.int32), found.data.astype(np.float64))

    def _tables(self, entries: SparseEntries, to: tuple[int, int], of: tuple[int, int]) -> None:
        """A matrix with rows ``to`` and columns ``of``, and its transpose, as `gather_rows` takes them."""
        entries = replace(entries, weight=entries.weight.astype(np.float32))
        self._rows = entries.table(self.device, to, BLOCK)
        self._columns = entries.transposed().table(self.device, of, BLOCK)

    def _to_cells(self, volume: DeviceArray, table: dict[str, DeviceArray], out: DeviceArray) -> None:
        """Gather cells, then slices of the rings."""
        part = out if self._slices.same else self.device.empty((*out.shape[:2], self.grid.shape[2]))
        self.device.launch(gather_rows, source=volume, **table, out=part)
        if part is not out:
            self._slices.to_slices(part, out)

    def _to_box(self, cells: DeviceArray, table: dict[str, DeviceArray], out: DeviceArray) -> None:
        """Gather slices of the grid, then voxels: the transpose of `_to_cells` with the other table."""
        part = cells
        if not self._slices.same:
            part = self.device.empty((*cells.shape[:2], self.grid.shape[2]))
            self._slices.from_slices(cells, part)
        self.device.launch(gather_rows, source=part, **table, out=out)


@final
class ToRings(_Means):
    """Mean of a volume over the cells of rings: voxels are constant, and 0 beyond the box.

    Areas of what cells and voxels have in common are found by 89 points of each cell, within 0.02 of it. A field that
    is smooth comes back from rings within its change over half a voxel.

    Args:
        grid: The voxels.
        rings: The cells.
        device: A name or a device; the best one here by default.

    Raises:
        BadInput: An argument is of another kind, or has too many voxels.
    """

    domain: VolumeSpace
    range: PolarSpace

    def __init__(self, grid: Grid, rings: PolarGrid, device: str | Device | None = None) -> None:
        super().__init__(grid, rings, device)
        self.domain, self.range = VolumeSpace(grid), PolarSpace(rings)  # pyright: ignore[reportIncompatibleVariableOverride] - never replaced
        # The resampling along z sums what slices hold [slices of the grid]; a mean divides by their height
        shares = self._shares()
        shares = replace(shares, weight=shares.weight * (grid.pitch / rings.slice_pitch))
        self._tables(shares, rings.shape[:2], grid.shape[:2])

    def forward(self, x: DeviceArray, out: DeviceArray) -> None:
        self._to_cells(x, self._rows, out)

    def transposed(self, y: DeviceArray, out: DeviceArray) -> None:
        self._to_box(y, self._columns, out)


@final
class ToVoxels(_Means):
    """Mean of a field on rings over the voxels of a box: cells are constant; 0 where there are none.

    Args:
        rings: The cells.
        grid: The voxels.
        device: A name or a device; the best one here by default.

    Raises:
        BadInput: An argument is of another kind, or has too many voxels.
    """

    domain: PolarSpace
    range: VolumeSpace

    def __init__(self, rings: PolarGrid, grid: Grid, device: str | Device | None = None) -> None:
        super().__init__(grid, rings, device)
        self.domain, self.range = PolarSpace(rings), VolumeSpace(grid)  # pyright: ignore[reportIncompatibleVariableOverride] - never replaced
        shares = self._shares().transposed()
        common = shares.weight * np.tile(rings.areas, rings.angles)[shares.column]
        covered = np.bincount(shares.row, common, grid.shape[0] * grid.shape[1])
        means = replace(shares, weight=common / covered[shares.row])
        self._tables(means, grid.shape[:2], rings.shape[:2])

    def forward(self, x: DeviceArray, out: DeviceArray) -> None:
        self._to_box(x, self._rows, out)

    def transposed(self, y: DeviceArray, out: DeviceArray) -> None:
        self._to_cells(y, self._columns, out)

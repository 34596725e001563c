"""Blur of a dose along x, y and z by oxygen that diffuses while the light is on."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property, lru_cache
from math import ceil, inf, sqrt
from typing import Annotated, final

import numpy as np

from vamgpu.backend import open_device
from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.geometry import Grid
from vamgpu.kernels.blur import blur_slices
from vamgpu.kernels.filter import filter_rows
from vamgpu.kernels.gather import gather_rows
from vamgpu.kernels.gauss import blur_planes
from vamgpu.kernels.resample import resample
from vamgpu.operators.compose import NO_FLOOR, combine
from vamgpu.operators.linear import LinearOperator
from vamgpu.operators.row_resampler import banded
from vamgpu.operators.space import VolumeSpace
from vamgpu.operators.traced_projection import BLOCK, SparseEntries
from vamgpu.schema import check
from vamgpu.schema.quantities import Diffusivity, ExposureTime, Quantity, Thickness
from vamgpu.web import WebGrid

DROPPED = 1e-7  # share of a kernel's weight that may be cut off


@dataclass(frozen=True)
class Diffusion:
    """Oxygen that spreads at a constant rate while light consumes it evenly over an exposure.

    Oxygen consumed at time t spreads until the end. The blur of a dose is therefore the mean over the exposure of heat
    kernels with variance 2D(T − t) along each axis; ``optical`` widens all of them.

    Sources: A. Orth et al., Nat. Commun. 14 (2023) 4412: diffusion and optical blur as one kernel to be deconvolved;
    the mean over the exposure is derived here.

    Args:
        diffusivity: D [mm²/s].
        seconds: Exposure T [s].
        optical: Standard deviation [mm] of the light's own blur.
        stages: Number of Gaussians that approximate this mean, at Gauss–Legendre nodes.

    Raises:
        BadInput: A value is out of its range.
    """

    diffusivity: Diffusivity
    seconds: ExposureTime
    optical: Thickness = 0.0
    stages: Annotated[int, Quantity(least=1, most=16, whole=True, hint="1 to 16 Gaussians")] = 4

    def __post_init__(self) -> None:
        check(self)

    @property
    def deviation(self) -> float:
        """Standard deviation [mm] of the whole blur along one axis: √(DT + optical²)."""
        return sqrt(self.diffusivity * self.seconds + self.optical**2)

    def gaussians(self) -> tuple[tuple[float, float], ...]:
        """Weight and variance [mm²] of each Gaussian, from the narrowest."""
        nodes, weights = np.polynomial.legendre.leggauss(self.stages)
        spread = 2.0 * self.diffusivity * self.seconds * 0.5 * (1.0 + nodes) + self.optical**2
        return tuple((float(0.5 * w), float(v)) for w, v in zip(weights, spread, strict=True))


def heat_taps(variance: float) -> np.ndarray:
    """One side of the heat kernel of the voxel grid, e^{−v}·I_n(v), whose variance is ``variance`` [voxels²]."""
    from scipy.special import ive

    taps = np.asarray(ive(np.arange(8 + ceil(7.5 * sqrt(variance))), variance))
    kept = np.cumsum(np.r_[taps[0], 2.0 * taps[1:]]) < 1.0 - DROPPED
    taps = taps[: int(kept.sum()) + 1]
    return taps / (2.0 * taps.sum() - taps[0])


@final
class Spread(LinearOperator):
    """Doses [x, y, z] after diffusion, on a device; the dose is 0 outside the volume and does not return from there.

    Each Gaussian is made from the previous one by the difference of their variances, with three short convolutions.

    Args:
        grid: The voxels of the doses.
        diffusion: Diffusion over an exposure.
        device: A name or a device; the best available device by default.
    """

    def __init__(self, grid: Grid | WebGrid, diffusion: Diffusion, device: str | Device | None = None) -> None:
        space = VolumeSpace(grid)
        self._set_spaces(space, space, open_device(device))
        self.grid: Grid | WebGrid = grid
        self.diffusion: Diffusion = diffusion
        edges = (grid.pitch,) * 3 if isinstance(grid, Grid) else grid.edges
        self._stages: list[tuple[float, tuple[DeviceArray, ...]]] = []
        before = 0.0
        for weight, variance in diffusion.gaussians():
            steps = [heat_taps((variance - before) / edge**2) for edge in edges]
            self._stages.append((weight, tuple(self.device.table(taps, "float32") for taps in steps)))
            before = variance

    @cached_property
    def _scratch(self) -> tuple[DeviceArray, DeviceArray, DeviceArray]:
        shape = self.domain.shape
        return self.device.empty(shape), self.device.empty(shape), self.device.empty(shape)

    def _blur(self, source: DeviceArray, taps: tuple[DeviceArray, ...], out: DeviceArray) -> None:
        """out = source blurred along y, x and z; out may be the source."""
        first, second, _ = self._scratch
        launch = self.device.launch
        launch(filter_rows, sinogram=source, taps=taps[1], stride=1, floor=NO_FLOOR, filtered=first)
        launch(blur_planes, source=first, taps=taps[0], blurred=second)
        launch(blur_slices, source=second, taps=taps[2], blurred=out)

    def forward(self, x: DeviceArray, out: DeviceArray) -> None:
        blurred, source = self._scratch[2], x
        for stage, (weight, taps) in enumerate(self._stages):
            self._blur(source, taps, blurred)
            combine(weight, blurred, float(stage > 0), out if stage else blurred, out)  # the first ``out`` may be NaN
            source = blurred

    def transposed(self, y: DeviceArray, out: DeviceArray) -> None:
        last, (first, second, _), launch = len(self._stages) - 1, self._scratch, self.device.launch
        for stage in range(last, -1, -1):
            weight, taps = self._stages[stage]
            combine(weight, y, float(stage < last), out if stage < last else y, out)
            # the transpose of a blur: the same steps in the opposite order
            launch(blur_slices, source=out, taps=taps[2], blurred=first)
            launch(blur_planes, source=first, taps=taps[0], blurred=second)
            launch(filter_rows, sinogram=second, taps=taps[1], stride=1, floor=NO_FLOOR, filtered=out)


STEP = 0.2
"""Longest step beside a wall, D·time / pitch²; its error is at most 0.9 % of a point's peak."""
FAINT = 1e-8  # entries of a heat kernel below this are added to the diagonal
Ends = tuple[bool, bool]
"""Whether the value beyond each end of a line of voxels is held at 0; no flux passes the other ends."""


class Heat:
    """A field after diffusion in a box, exact in time for differences of sixth order: a pass each along y, x and z."""

    # variance: D·time [mm²], half the variance of the kernel. fixed: names of faces with a value of 0. No flux passes
    # others, nor the wall, beside which passes along x and y do not commute: they alternate in steps of `STEP` at most.

    def __init__(
        self, grid: Grid, variance: float, device: Device, fixed: Sequence[str] = (), wall: float = inf
    ) -> None:
        self.device: Device = device
        self._spare = [device.empty(grid.shape) for _ in range(2)]
        ends = [(f"{axis} low" in fixed, f"{axis} high" in fixed) for axis in "xyz"]
        x, y, _ = grid.axes()
        self._box = grid, ends, x[:, None] ** 2 + y[None, :] ** 2 <= wall**2
        self._set(variance)

    def _set(self, variance: float) -> None:
        grid, ends, open_ = self._box
        spread = variance / grid.pitch**2
        steps, halves = (1, 1) if open_.all() else (max(ceil(spread / STEP), 1), 2)
        rows = [_lines(open_, ends[0], spread / steps, 0), _lines(open_.T, ends[1], spread / steps / halves, 1)]
        along_x, along_y = (each.table(self.device, grid.shape[:2], BLOCK) for each in rows)
        self._tables = [along_y, along_x, *[along_y] * (halves - 1)] * steps
        self._slices = banded(self.device, heat_matrix(grid.shape[2], spread, ends[2]))

    def of(self, variance: float, fixed: bool) -> Heat:
        """Another span of diffusion in this box, with its fixed faces or none; a negative one takes it back."""
        other, (grid, ends, open_) = copy(self), self._box
        other._box = grid, ends if fixed else [(False, False)] * 3, open_
        other._set(variance)
        return other

    def spread(self, field: DeviceArray, back: bool = False) -> None:
        """Replace a field [x, y, z] by that after diffusion; ``back``: the transpose, in the opposite order."""
        (first, second), launch = self._spare, self.device.launch
        if back:
            launch(resample, source=field, lanes=field, target=first, **self._slices)
        else:
            launch(gather_rows, source=field, **self._tables[0], out=first)
        for table in self._tables[:0:-1] if back else self._tables[1:]:
            launch(gather_rows, source=first, **table, out=second)
            first, second = second, first
        if back:
            launch(gather_rows, source=first, **self._tables[0], out=field)
        else:
            launch(resample, source=first, lanes=first, target=field, **self._slices)


@lru_cache(maxsize=8)
def heat_matrix(count: int, spread: float, ends: Ends) -> np.ndarray:
    """Symmetric matrix of diffusion on a line of voxels, ``spread`` = D·time / pitch²; without ends, rows sum to 1."""
    from scipy.linalg import eigh_tridiagonal

    diagonal = np.full(count, -2.0)
    for at, held in ((0, ends[0]), (-1, ends[1])):
        diagonal[at] += -1.0 if held else 1.0
    rates, waves = eigh_tridiagonal(diagonal, np.ones(count - 1))
    rates = rates - rates**2 / 12.0 + rates**3 / 90.0  # the first alone spreads waves of a few voxels too slowly
    matrix = (waves * np.exp(spread * rates)) @ waves.T
    matrix = 0.5 * (matrix + matrix.T)
    faint = np.abs(matrix) < FAINT
    return np.where(faint, 0.0, matrix) + np.diag((matrix * faint).sum(axis=1))


def _lines(open_: np.ndarray, ends: Ends, spread: float, axis: int) -> SparseEntries:
    """Diffusion along the first axis of the open voxels; voxels [x, y] are counted along y."""
    length, lines = open_.shape
    found = []
    for line in open_.sum(axis=0).argsort(kind="stable").tolist():  # equal lengths together: `heat_matrix` is kept
        inside, first = int(open_[:, line].sum()), int(open_[:, line].argmax())
        touched = (ends[0] and first == 0, ends[1] and first + inside == length)
        matrix = np.eye(length)
        matrix[first : first + inside, first : first + inside] = heat_matrix(inside, spread, touched) if inside else 0.0
        row, column = np.nonzero(matrix)
        place = (lambda at, line=line: at * lines + line) if axis == 0 else (lambda at, line=line: line * length + at)
        found.append((place(row), place(column), matrix[row, column]))
    row, column, weight = (np.concatenate(each) for each in zip(*found, strict=True))
    return SparseEntries(row.astype(np.int32), column.astype(np.int32), weight.astype(np.float64))

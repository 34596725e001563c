"""Blur of a dose along x, y and z by oxygen that diffuses while the light is on."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import ceil, sqrt
from typing import Annotated, final

import numpy as np

from vamgpu.backend import open_device
from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.geometry import Grid
from vamgpu.kernels.blur import blur_slices
from vamgpu.kernels.filter import filter_rows
from vamgpu.kernels.gauss import blur_planes
from vamgpu.kernels.update import linear
from vamgpu.operators.compose import NO_FLOOR
from vamgpu.operators.linear import LinearOperator
from vamgpu.operators.space import VolumeSpace, WebSpace
from vamgpu.schema import check
from vamgpu.schema.quantities import Diffusivity, ExposureTime, Quantity, Thickness
from vamgpu.web import WebGrid

DROPPED = 1e-7
"""Share of a kernel's weight that may be cut off."""


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

    def transfer(self, frequency: float) -> float:
        """Attenuation of a wave in a continuous medium, with the exact mean.

        Args:
            frequency: Frequency of the wave [rad/mm].

        Returns:
            The remaining share.
        """
        q = self.diffusivity * self.seconds * frequency**2
        left = -np.expm1(-q) / q if q > 0 else 1.0
        return float(left * np.exp(-0.5 * (self.optical * frequency) ** 2))


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

    domain: VolumeSpace | WebSpace
    range: VolumeSpace | WebSpace
    device: Device
    grid: Grid | WebGrid
    diffusion: Diffusion

    def __init__(self, grid: Grid | WebGrid, diffusion: Diffusion, device: str | Device | None = None) -> None:
        self.domain = VolumeSpace(grid) if isinstance(grid, Grid) else WebSpace(grid)  # pyright: ignore[reportIncompatibleVariableOverride] - and never replaced
        self.range = self.domain  # pyright: ignore[reportIncompatibleVariableOverride] - and never replaced
        self.grid, self.diffusion, self.device = grid, diffusion, open_device(device)
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
            self._add(weight, blurred, 0.0 if stage == 0 else 1.0, out)
            source = blurred

    def transposed(self, y: DeviceArray, out: DeviceArray) -> None:
        last = len(self._stages) - 1
        for stage in range(last, -1, -1):
            weight, taps = self._stages[stage]
            self._add(weight, y, 0.0 if stage == last else 1.0, out)
            self._blur_back(out, taps)

    def _blur_back(self, field: DeviceArray, taps: tuple[DeviceArray, ...]) -> None:
        """The transpose of a blur, in place: the same steps in the opposite order."""
        first, second, _ = self._scratch
        launch = self.device.launch
        launch(blur_slices, source=field, taps=taps[2], blurred=first)
        launch(blur_planes, source=first, taps=taps[0], blurred=second)
        launch(filter_rows, sinogram=second, taps=taps[1], stride=1, floor=NO_FLOOR, filtered=field)

    def _add(self, weight: float, x: DeviceArray, kept: float, out: DeviceArray) -> None:
        """out = weight·x + kept·out; if kept is 0, ``out`` may hold anything."""
        self.device.launch(linear, a=weight, x=x, b=kept, y=out if kept else x, floor=NO_FLOOR, out=out)

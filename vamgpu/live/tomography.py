"""Optical scattering tomography: the field of conversion from the images of one turn."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any
from weakref import ref

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.errors import BadInput
from vamgpu.kernels.blur import blur_slices
from vamgpu.kernels.camera import draw_noise, take_bias
from vamgpu.kernels.filter import filter_rows
from vamgpu.kernels.gauss import blur_planes
from vamgpu.kernels.update import correct_by_ratio, multiply
from vamgpu.kernels.watch import interpolate
from vamgpu.live.camera import MonitoringCamera
from vamgpu.live.fields import here
from vamgpu.live.rings import on_rings
from vamgpu.live.smoothing import Smoothing
from vamgpu.live.turbidity import Turbidity
from vamgpu.metrics.histogram import above
from vamgpu.metrics.parts import IN, Parts
from vamgpu.operators.compose import NO_FLOOR, combine
from vamgpu.operators.projection import Projection
from vamgpu.operators.reductions import dot
from vamgpu.operators.ring_projection import RingProjection
from vamgpu.operators.space import require

ITERATIONS = 30
NEIGHBORS = 12.0  # greatest sum of absolute values in a row of the second differences along three axes
TINY = 1e-30  # a value below any weight and any bound of a step
MOST = 1e6  # greatest ratio of the variances of two turns
CONTRAST = 0.2
"""Typical difference of neighboring voxels, relative to the extinction of fully cured resin; a larger value would give
sharper and noisier fields."""
PATCH = 2.0  # standard deviation [voxels] of the patches in which a deviation is measured


@dataclass(frozen=True, eq=False)
class OpticalDepths:
    """Optical depths of a turn's images, in the geometry of a camera's projection, on its device."""

    depth: DeviceArray  # multiplied by the share of its column's light that enters, [angle, r, z]
    weight: DeviceArray  # 1/variance, [angle, r, z]; 0 for invalid pixels
    pixels: int  # number of valid pixels


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """The field reconstructed from the images of a turn."""

    field: DeviceArray  # extinction above that of the resin before the print [1/mm], [x, y, z] on the device
    cured: DeviceArray  # conversion of the resin, [x, y, z] on the device
    misfit: float  # mean square of images less field, over the noise's variance: near 1 if camera and noise are right
    contrast: float  # mean square of the images' optical depths over the variance of the noise, dimensionless

    @cached_property
    def extinction(self) -> np.ndarray:
        """`field` as a NumPy array [1/mm], [x, y, z]."""
        return np.asarray(self.field.numpy(), np.float32)

    @cached_property
    def conversion(self) -> np.ndarray:
        """`cured` as a NumPy array, [x, y, z]."""
        return np.asarray(self.cured.numpy(), np.float32)


class Tomograph:
    """Fields of conversion from the images of a `MonitoringCamera`, turn by turn.

    The most probable extinction x ≥ 0, given the images and their noise, if neighbors differ little:

        minimize Σ w·(A x − y)² + Σ_neighbors (x − x')² / δ²

    with optical depths y of weight w = 1/variance, and δ = `CONTRAST` times the extinction of fully cured resin. Steps
    have Nesterov's momentum. Their length in each voxel is that of a separable surrogate (H. Erdoğan, J. Fessler, Phys.
    Med. Biol. 44 (1999) 2835), which needs no tuning.
    Effects of the camera that are not linear (point spread of light instead of its logarithm, bending) are computed
    from the last field.

    Only resin within the vial's printable radius is reconstructed; farther out it counts as uncured.

    Args:
        camera: The camera of the images.
        turbidity: Turbidity of the resin.
        rings: Whether to reconstruct on rings, see `RingProjection`; None if they are faster.
    """

    camera: MonitoringCamera
    turbidity: Turbidity
    rings: bool | None

    def __init__(self, camera: MonitoringCamera, turbidity: Turbidity, *, rings: bool | None = None) -> None:
        self.camera, self.turbidity, self.rings = camera, turbidity, rings
        self._device = camera.projection.device
        self._stiffness = (CONTRAST * turbidity.full) ** -2
        self._bound: tuple[ref[OpticalDepths], DeviceArray] | None = None
        self._noise = lru_cache(1)(self._open_noise)

    @cached_property
    def operator(self) -> Projection | RingProjection:
        """The operator of reconstructions; its tables are made on first use."""
        return on_rings(self.camera.projection, self.rings) or self.camera.projection

    def measure(self, images: Any) -> OpticalDepths:
        """Optical depths of a turn's images; `see` and `deviation` accept them in place of the images.

        Args:
            images: Gray levels [angle, row, column]; lost frames are NaN.

        Returns:
            Depths and weights, on the device.

        Raises:
            BadInput: No pixel is valid.
            ShapeMismatch: The images are of another geometry.
        """
        depth, weight = self.camera.measured(images)
        pixels = int(above(Parts.whole(weight), TINY)[0, IN, 1])
        if not pixels:
            raise BadInput("no pixel of the images is lit, below saturation and finite; expected one turn of the lit "
                           "vial: check exposure, bits and noise of the camera")  # fmt: skip
        return OpticalDepths(depth, weight, pixels)

    def see(self, images: Any, last: Reconstruction | None = None, *, iterations: int = ITERATIONS) -> Reconstruction:
        """Reconstruct the field from the images of one turn.

        Args:
            images: Gray levels [angle, row, column]; lost frames are NaN. Alternatively, the result of `measure`.
            last: Result of the previous turn, as a start.
            iterations: Number of projector evaluations.

        Returns:
            The field.

        Raises:
            BadInput: No pixel is valid, or iterations is below 1.
            ShapeMismatch: Images or field are of another geometry.
        """
        depths = self._measured(images, iterations)
        start, depth, linear = self._device.empty(self.operator.domain.shape), depths.depth, None
        if last is None:
            combine(0.0, self._ones, 0.0, self._ones, start)
        else:
            require(self.operator.domain, last.field, "the last field")
            was = here(self._device, last.field)
            combine(1.0, was, 0.0, was, start)
            linear = self.operator(start)
            depth = self._unbiased(depth, start, linear, last)
        steps = _Descent(self, depth, depths, start, floor=0.0, projected=linear)
        for _ in range(iterations):
            steps.advance()
        misfit = steps.misfit  # before the contrast
        return Reconstruction(steps.field, self.conversion(steps.field), misfit, steps.contrast)

    def conversion(self, extinction: DeviceArray) -> DeviceArray:
        """Conversion by the assumed turbidity.

        Args:
            extinction: Extinction above that of the resin before the print [1/mm], [x, y, z] on the device.

        Returns:
            Conversion, [x, y, z] on the device.
        """
        cured = self._device.empty(extinction.shape)
        self._device.launch(interpolate, x=extinction, **self._conversions, out=cured)
        return cured

    def deviation(self, images: Any, *, iterations: int = ITERATIONS) -> np.ndarray:
        """Standard deviation of the extinction due to the noise of a turn's images.

        Simulated noise of the open field goes through the same steps once, and its magnitude is measured around every
        voxel. Where the rays through a voxel have less weight, a turn's is greater. Ignored: errors of smoothing, and
        x ≥ 0, which makes voids more certain.

        Args:
            images: As for `see`, gray levels [angle, row, column] or `OpticalDepths`.
            iterations: As for `see`; the first call with it takes the same time.

        Returns:
            [1/mm], [x, y, z]; multiply by `Turbidity.slope_at` for that of the conversion.

        Raises:
            BadInput: No pixel is valid, or iterations is below 1.
            ShapeMismatch: The images are of another geometry.
        """
        return np.sqrt(self.variance(images, iterations=iterations).numpy())

    def variance(self, images: Any, *, iterations: int = ITERATIONS) -> DeviceArray:
        """The square of `deviation`, left on the device.

        Args:
            images: As for `deviation`.
            iterations: As for `deviation`.

        Returns:
            [1/mm²], [x, y, z] on the device.

        Raises:
            BadInput: As `deviation`.
            ShapeMismatch: As `deviation`.
        """
        depths = self._measured(images, iterations)
        variance, length = self._noise(iterations)
        scaled = combine(1.0, variance, 0.0, variance, self._device.empty(variance.shape))
        ends = {"scale": 1.0, "target": self._step_bound(depths), "low": 0.0, "high": 1.0, "most": MOST}
        self._device.launch(correct_by_ratio, dose=length, **ends, model=scaled)
        return scaled

    def _open_noise(self, iterations: int) -> tuple[DeviceArray, DeviceArray]:
        """Variance of the extinction by the noise of images of fresh resin, and the lengths of their steps."""
        depths = self.measure(np.broadcast_to(self.camera.open_field, self.camera.shape))
        noise, start = self._device.empty(self.operator.range.shape), self._device.empty(self.operator.domain.shape)
        rows = self._device.table(np.arange(self.operator.range.shape[2]), "int32")
        self._device.launch(draw_noise, weight=depths.weight, slices=rows, seed=0, noise=noise)
        combine(0.0, self._ones, 0.0, self._ones, start)
        steps = _Descent(self, noise, depths, start, floor=NO_FLOOR)
        for _ in range(iterations):
            steps.advance()
        self._device.launch(multiply, x=steps.field, y=steps.field, out=start)
        return Smoothing(self._device, self.operator.domain.shape, PATCH)(start), self._step_bound(depths)

    def _measured(self, images: Any, iterations: int) -> OpticalDepths:
        if isinstance(iterations, bool) or not isinstance(iterations, int) or iterations < 1:
            raise BadInput(f"iterations is {iterations!r}; expected a whole number of at least 1")
        return images if isinstance(images, OpticalDepths) else self.measure(images)

    def _unbiased(
        self, depth: DeviceArray, extinction: DeviceArray, linear: DeviceArray, last: Reconstruction
    ) -> DeviceArray:  # fmt: skip
        """Depths minus the camera's excess depth of a field over the linear operator's, [angle, r, z]."""
        index = None
        if self.turbidity.index and self.camera.focus:
            index = self.turbidity.index_at(self.turbidity.conversion_at(last.extinction))
        dark, out = self.camera.darkened(extinction, index), self._device.empty(depth.shape)
        combine(1.0, depth, 0.0, depth, out)
        self._device.launch(take_bias, dark=dark, linear=linear, reached=self.camera.share, depth=out)
        return out

    @cached_property
    def _conversions(self) -> dict[str, DeviceArray]:
        """Samples of extinction, and of conversion there, as tables."""
        return {name: self._device.table(np.array(values)) for name, values in
                (("knots", self.turbidity.extinction), ("values", self.turbidity.conversion))}  # fmt: skip

    @cached_property
    def _ones(self) -> DeviceArray:
        return self._device.upload(np.ones(self.operator.domain.shape, np.float32))

    @cached_property
    def _lengths(self) -> DeviceArray:
        """A·1, the length of every ray in the grid."""
        return self.operator(self._ones)

    def _step_bound(self, depths: OpticalDepths) -> DeviceArray:
        """Length of a step in each voxel; that of the last depths is kept."""
        if self._bound is None or self._bound[0]() is not depths:
            device, A = self._device, self.operator
            weighted, slope, length = (device.empty(space.shape) for space in (A.range, A.domain, A.domain))
            device.launch(multiply, x=self._lengths, y=depths.weight, out=weighted)
            A.T(weighted, out=slope)
            combine(1.0, slope, NEIGHBORS * self._stiffness, self._ones, slope)
            combine(1.0, self._ones, 0.0, self._ones, length)
            over = {"scale": 1.0, "target": self._ones, "low": 1.0, "high": 1.0, "most": 1.0 / TINY}  # inverse of slope
            device.launch(correct_by_ratio, dose=slope, **over, model=length)
            self._bound = ref(depths), length
        return self._bound[1]

    @cached_property
    def _bending(self) -> DeviceArray:
        """Taps of a second difference."""
        return self._device.table(np.array([2.0, -1.0]))


class _Descent:
    """Steps towards the most probable field, all on the device."""

    def __init__(
        self, tomograph: Tomograph, depth: DeviceArray, depths: OpticalDepths, start: DeviceArray, floor: float,
        projected: DeviceArray | None = None,
    ) -> None:  # fmt: skip
        self._tomograph, self._A, self._floor, self._taken = tomograph, tomograph.operator, floor, 0
        self._depth, self._weight, self._pixels = depth, depths.weight, depths.pixels
        device, self._projected, self._length = self._A.device, projected, tomograph._step_bound(depths)
        self._residual, self._weighted = device.empty(depth.shape), device.empty(depth.shape)
        self.field, (self._ahead, self._slope, self._part, self._next) = (
            start, (device.empty(start.shape) for _ in range(4))
        )  # fmt: skip
        combine(1.0, start, 0.0, start, self._ahead)

    @property
    def misfit(self) -> float:
        """Mean square of the residuals of the last step, in standard deviations."""
        return dot(self._residual, self._weighted) / self._pixels

    @property
    def contrast(self) -> float:
        """Mean square of the depths, in standard deviations; call `misfit` first: this overwrites its fields."""
        self._A.device.launch(multiply, x=self._depth, y=self._weight, out=self._weighted)
        return dot(self._depth, self._weighted) / self._pixels

    def advance(self) -> None:
        """One forward and one back projection; that of the start may be known."""
        launch: Callable[..., None] = self._A.device.launch
        linear, self._projected = self._projected, None
        if linear is None:
            linear = self._A(self._ahead, out=self._residual)
        combine(1.0, linear, -1.0, self._depth, self._residual)
        launch(multiply, x=self._residual, y=self._weight, out=self._weighted)
        self._A.T(self._weighted, out=self._slope)
        self._add_differences()
        launch(multiply, x=self._slope, y=self._length, out=self._slope)
        combine(1.0, self._ahead, -1.0, self._slope, self._next, floor=self._floor)
        momentum = self._taken / (self._taken + 3.0)
        combine(1.0 + momentum, self._next, -momentum, self.field, self._ahead)
        self.field, self._next, self._taken = self._next, self.field, self._taken + 1

    def _add_differences(self) -> None:
        """Add the gradient of the differences between neighbors."""
        launch, taps, part = self._A.device.launch, self._tomograph._bending, self._part
        for across in range(3):
            if across == 0:
                launch(blur_planes, source=self._ahead, taps=taps, blurred=part)
            elif across == 1:
                launch(filter_rows, sinogram=self._ahead, taps=taps, stride=1, floor=NO_FLOOR, filtered=part)
            else:
                launch(blur_slices, source=self._ahead, taps=taps, blurred=part)
            combine(1.0, self._slope, self._tomograph._stiffness, part, self._slope)

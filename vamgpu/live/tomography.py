"""Optical scattering tomography: the field of conversion from the images of one turn."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from math import inf
from time import perf_counter
from typing import Any

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.errors import BadInput
from vamgpu.geometry import positive
from vamgpu.kernels.blur import blur_slices
from vamgpu.kernels.filter import filter_rows
from vamgpu.kernels.gauss import blur_planes
from vamgpu.kernels.update import multiply
from vamgpu.live.camera import MonitoringCamera
from vamgpu.live.turbidity import Turbidity
from vamgpu.operators.compose import NO_FLOOR, combine
from vamgpu.operators.reductions import dot
from vamgpu.operators.space import require

ITERATIONS = 30
NEIGHBORS = 12.0
"""Greatest sum of a row of the second differences along three axes, sizes counted."""
FAINT = 1e-6
"""Least share of light whose logarithm is taken."""
PATCH = 2.0
"""Standard deviation [voxels] of the patches in which a deviation is measured."""


@dataclass(frozen=True, eq=False)
class Seen:
    """What a turn of images says.

    Attributes:
        extinction: Above that of the resin before the print [1/mm], [x, y, z].
        conversion: Of the resin, [x, y, z].
        iterations: Pairs of projections that were made; a replay asks for as many.
        misfit: Mean square of what images and field differ by over the variance of the noise, dimensionless: near 1
            where camera and noise are as described.
        seconds: How long it took [s].
    """

    extinction: np.ndarray
    conversion: np.ndarray
    iterations: int
    misfit: float
    seconds: float


class Tomograph:
    """Fields of conversion from the images of a `MonitoringCamera`, turn by turn.

    The most probable extinction x ≥ 0 of images with their noise and of neighbors that differ little:

        minimize Σ w·(A x − y)² + Σ_neighbors (x − x')² / δ²

    with optical depths y of weight w = 1/variance. Steps have Nesterov's momentum and, voxel by voxel, lengths of a
    separable surrogate (H. Erdoğan, J. Fessler, Phys. Med. Biol. 44 (1999) 2835), so that nothing has to be tuned. What
    the camera does that is not linear (point spread of light instead of its logarithm, bending) is taken from the last
    field.

    Only resin within the vial's printable radius is seen; farther out it counts as not cured.

    Args:
        camera: That took the images.
        turbidity: Of the resin.
        contrast: δ, how much neighboring voxels differ, over the extinction of fully cured resin. The more, the
            sharper and the noisier.

    Raises:
        BadInput: The contrast is not above 0.
    """

    camera: MonitoringCamera
    turbidity: Turbidity
    contrast: float

    def __init__(self, camera: MonitoringCamera, turbidity: Turbidity, contrast: float = 0.2) -> None:
        self.camera, self.turbidity = camera, turbidity
        self.contrast = positive("contrast", contrast)
        self._A, self._device = camera.projection, camera.projection.device
        self._stiffness = (self.contrast * turbidity.full) ** -2

    def see(
        self, images: Any, last: Seen | None = None, *, iterations: int = ITERATIONS, deadline: float = inf
    ) -> Seen:
        """The field behind the images of one turn.

        Args:
            images: Gray levels [angle, row, column]; frames that were lost are NaN.
            last: What the turn before said, to go on from.
            iterations: Pairs of projections at most.
            deadline: Time that it may take [s]; the best field so far is returned, after one iteration at least.

        Returns:
            The field.

        Raises:
            BadInput: No pixel is good, or fewer than one iteration is asked for.
            ShapeMismatch: Images or field are of another geometry.
        """
        begun = perf_counter()
        depth, weight = self._measured(images, iterations)
        start = np.zeros(self._A.domain.shape, np.float32)
        if last is not None:
            require(self._A.domain, last.extinction, "the last field")
            start = last.extinction
            depth = depth - self._bias(start)
        steps = _Descent(self, depth, weight, start, floor=0.0)
        done, longest, now = 0, 0.0, perf_counter()
        while done < iterations and (not done or now + longest - begun < deadline):
            steps.advance()
            if deadline < inf:
                self._device.synchronize()
            done, longest, now = done + 1, max(longest, perf_counter() - now), perf_counter()
        extinction = steps.field.numpy().astype(np.float32)
        conversion = self.turbidity.conversion_at(extinction).astype(np.float32)
        return Seen(extinction, conversion, done, steps.misfit, perf_counter() - begun)

    def deviation(self, images: Any, *, iterations: int = ITERATIONS, seed: int = 0) -> np.ndarray:
        """Standard deviation of the extinction that the noise of a turn's images leaves.

        Noise as the camera has it goes through the same steps, and its size is measured about every voxel. That x ≥ 0
        makes void more certain does not count, nor what smoothing rounds off.

        Args:
            images: Gray levels [angle, row, column].
            iterations: As for `see`; it takes as long.
            seed: Of the noise.

        Returns:
            [1/mm], [x, y, z]; times `Turbidity.slope_at` that of the conversion.

        Raises:
            BadInput: No pixel is good, or fewer than one iteration is asked for.
            ShapeMismatch: The images are of another geometry.
        """
        from scipy.ndimage import gaussian_filter  # takes longer to load than all of vamgpu

        _, weight = self._measured(images, iterations)
        noise = np.random.default_rng(seed).standard_normal(weight.shape, np.float32)
        noise *= np.where(weight > 0, 1.0 / np.sqrt(np.maximum(weight, 1e-30)), 0.0)
        steps = _Descent(self, noise, weight, np.zeros(self._A.domain.shape, np.float32), floor=NO_FLOOR)
        for _ in range(iterations):
            steps.advance()
        return np.sqrt(gaussian_filter(np.square(steps.field.numpy()), PATCH, mode="nearest"))

    def _measured(self, images: Any, iterations: int) -> tuple[np.ndarray, np.ndarray]:
        if isinstance(iterations, bool) or not isinstance(iterations, int) or iterations < 1:
            raise BadInput(f"iterations is {iterations!r}; expected a whole number of at least 1")
        depth, weight = self.camera.optical_depth(images)
        if not weight.any():
            raise BadInput("no pixel of the images is lit, below saturation and finite; expected one turn of the lit "
                           "vial: check exposure, bits and noise of the camera")  # fmt: skip
        return depth, weight

    def _bias(self, extinction: np.ndarray) -> np.ndarray:
        """How much deeper the camera sees a field than the linear operator says, [angle, r, z]."""
        index = self.turbidity.index_at(self.turbidity.conversion_at(extinction)) if self.turbidity.index else None
        seen = -np.log(np.maximum(self.camera.transmission(extinction, index), FAINT))
        reached = self.camera.reached
        linear = np.asarray(self._A(np.asarray(extinction, np.float32)))
        return seen - linear * np.where(reached > 0, 1.0 / np.maximum(reached, 1e-6), 0.0)

    @cached_property
    def _lengths(self) -> DeviceArray:
        """A·1, what every ray passes of the grid."""
        ones = self._device.upload(np.ones(self._A.domain.shape, np.float32))
        return self._A(ones)

    @cached_property
    def _bending(self) -> DeviceArray:
        """Taps of a second difference."""
        return self._device.table(np.array([2.0, -1.0]))


class _Descent:
    """Steps towards the most probable field, all on the device."""

    def __init__(
        self, tomograph: Tomograph, depth: np.ndarray, weight: np.ndarray, start: np.ndarray, floor: float
    ) -> None:
        self._tomograph, self._A, self._floor, self._taken = tomograph, tomograph._A, floor, 0
        device, reached = self._A.device, tomograph.camera.reached
        # The operator's values are a ray's lengths times the share of its light that gets in.
        self._depth = device.upload((depth * reached).astype(np.float32))
        heavy = np.where(reached > 0, weight / np.maximum(reached, 1e-6) ** 2, 0.0)
        self._weight = device.upload(heavy.astype(np.float32))
        self._pixels = max(int(np.count_nonzero(heavy)), 1)
        self._residual, self._weighted = device.empty(depth.shape), device.empty(depth.shape)
        self.field = device.upload(start.astype(np.float32))
        self._ahead = device.upload(start.astype(np.float32))
        self._slope, self._part, self._next = (device.empty(start.shape) for _ in range(3))
        device.launch(multiply, x=tomograph._lengths, y=self._weight, out=self._weighted)
        bound = self._A.T(self._weighted).numpy() + NEIGHBORS * tomograph._stiffness
        self._length = device.upload((1.0 / bound).astype(np.float32))

    @property
    def misfit(self) -> float:
        """Mean square of the residuals of the last step, in standard deviations."""
        return dot(self._residual, self._weighted) / self._pixels

    def advance(self) -> None:
        """One pair of projections."""
        launch: Callable[..., None] = self._A.device.launch
        self._A(self._ahead, out=self._residual)
        combine(1.0, self._residual, -1.0, self._depth, self._residual)
        launch(multiply, x=self._residual, y=self._weight, out=self._weighted)
        self._A.T(self._weighted, out=self._slope)
        self._add_differences()
        launch(multiply, x=self._slope, y=self._length, out=self._slope)
        combine(1.0, self._ahead, -1.0, self._slope, self._next, floor=self._floor)
        momentum = self._taken / (self._taken + 3.0)
        combine(1.0 + momentum, self._next, -momentum, self.field, self._ahead)
        self.field, self._next, self._taken = self._next, self.field, self._taken + 1

    def _add_differences(self) -> None:
        """What neighbors that differ add to the slope."""
        launch, taps, part = self._A.device.launch, self._tomograph._bending, self._part
        for across in range(3):
            if across == 0:
                launch(blur_planes, source=self._ahead, taps=taps, blurred=part)
            elif across == 1:
                launch(filter_rows, sinogram=self._ahead, taps=taps, stride=1, floor=NO_FLOOR, filtered=part)
            else:
                launch(blur_slices, source=self._ahead, taps=taps, blurred=part)
            combine(1.0, self._slope, self._tomograph._stiffness, part, self._slope)

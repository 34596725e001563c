"""Doses that reach the target after oxygen has diffused: regularized deconvolution, never negative."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from math import ceil, prod, sqrt

import numpy as np
import numpy.typing as npt

from vamgpu.backend import open_device
from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.chemistry.diffusion import Diffusion, Spread
from vamgpu.errors import BadInput, ShapeMismatch
from vamgpu.geometry import Grid, positive
from vamgpu.kernels.update import linear
from vamgpu.operators.compose import NO_FLOOR, combine
from vamgpu.operators.reductions import dot, extent
from vamgpu.web import WebGrid

RIDGE = 1e-3
ITERATIONS = 40
PAPERS = (
    "A. Orth et al., Deconvolution volumetric additive manufacturing, Nat. Commun. 14 (2023) 4412",
    "A. Beck, M. Teboulle, A fast iterative shrinkage-thresholding algorithm, SIAM J. Imaging Sci. 2 (2009) 183",
)
HALO = 9.0  # border of a block of slices that is solved and then dropped, in standard deviations of the blur


@dataclass(frozen=True, eq=False)
class Compensated:
    """A compensated dose and its misfit."""

    dose: DeviceArray  # [x, y, z] ≥ 0, on the device
    before: float  # root mean square misfit of the plain dose after diffusion, over all voxels
    after: float  # likewise of the compensated dose
    greatest: float  # largest dose, which the light must be able to give

    @property
    def factor(self) -> float:
        """Ratio of the misfit before compensation to that after; infinite if none remains."""
        return self.before / self.after if self.after > 0 else float("inf")


def precompensate(
    fraction: DeviceArray | npt.NDArray[np.floating],
    grid: Grid | WebGrid,
    diffusion: Diffusion,
    *,
    background: float = 0.0,
    ridge: float = RIDGE,
    iterations: int = ITERATIONS,
    device: str | Device | None = None,
) -> Compensated:
    """The dose that leaves background + (1 − background)·fraction after diffusion. Raises `BadInput`."""
    # Minimizes ‖K·dose − target‖² + ridge·‖dose − target‖² over dose ≥ 0 by accelerated projected gradients. The
    # background replaces negative light: without it, fine detail can hardly be sharpened.
    spread = Spread(grid, diffusion, fraction.device if isinstance(fraction, DeviceArray) else device)
    goal = _on(spread, fraction)
    shape = contrast(spread, goal, background, ridge=ridge, iterations=iterations)
    before, after = misfit(spread, goal, goal), misfit(spread, shape, goal)
    ones = spread.device.upload(np.ones(goal.shape, np.float32))
    spread.device.launch(linear, a=1.0 - background, x=shape, b=background, y=ones, floor=0.0, out=shape)
    rooted = (1.0 - background) / sqrt(prod(goal.shape))
    return Compensated(shape, before * rooted, after * rooted, extent(shape)[1])


def contrast(
    spread: Spread, goal: DeviceArray, background: float = 0.0, *, ridge: float = RIDGE, iterations: int = ITERATIONS
) -> DeviceArray:
    """u such that background + (1 − background)·u ≥ 0, and u after diffusion is near the goal; on the device."""
    if not 0.0 <= background < 1.0:
        raise BadInput(f"background is {background!r}; expected 0 ≤ background < 1")
    positive("ridge", ridge)
    if isinstance(iterations, bool) or not isinstance(iterations, int) or iterations < 1:
        raise BadInput(f"iterations is {iterations!r}; expected at least 1")
    device, floor = spread.device, -background / (1.0 - background)
    shape, ahead, new = (combine(1.0, goal, 0.0, goal, goal.device.empty(goal.shape)) for _ in range(3))
    image, slope = device.empty(goal.shape), device.empty(goal.shape)
    step, pace = 1.0 / (1.0 + ridge), 1.0
    for _ in range(iterations):
        spread.forward(ahead, image)
        device.launch(linear, a=1.0, x=image, b=-1.0, y=goal, floor=NO_FLOOR, out=image)
        spread.transposed(image, slope)
        device.launch(linear, a=-step, x=slope, b=step * ridge, y=goal, floor=NO_FLOOR, out=slope)
        device.launch(linear, a=1.0 - step * ridge, x=ahead, b=1.0, y=slope, floor=floor, out=new)
        faster = 0.5 * (1.0 + sqrt(1.0 + 4.0 * pace**2))
        gain = (pace - 1.0) / faster
        device.launch(linear, a=1.0 + gain, x=new, b=-gain, y=shape, floor=NO_FLOOR, out=ahead)
        shape, new, pace = new, shape, faster
    return shape


def misfit(spread: Spread, dose: DeviceArray, goal: DeviceArray) -> float:
    """‖K·dose − goal‖."""
    image = spread.device.empty(goal.shape)
    spread.forward(dose, image)
    spread.device.launch(linear, a=1.0, x=image, b=-1.0, y=goal, floor=NO_FLOOR, out=image)
    return sqrt(max(dot(image, image), 0.0))


def stream(
    slabs: Iterable[npt.NDArray[np.floating]],
    grid: Grid,
    diffusion: Diffusion,
    *,
    background: float = 0.0,
    ridge: float = RIDGE,
    iterations: int = ITERATIONS,
    block: int = 64,
    halo: int | None = None,
    device: str | Device | None = None,
) -> Iterator[npt.NDArray[np.float32]]:
    """Compensated doses of an endless column, slab [x, y, any z] by slab, in bounded memory. Raises `BadInput`."""
    here = open_device(device)
    margin = ceil(HALO * diffusion.deviation / grid.pitch) + 2 if halo is None else halo
    if block < 1 or margin < 0:
        raise BadInput(f"block is {block!r}, halo {margin!r}; expected at least 1 and 0 slices")
    column = np.zeros((*grid.shape[:2], margin), np.float32)
    spreads: dict[int, Spread] = {}

    def solved(part: npt.NDArray[np.float32], keep: int) -> npt.NDArray[np.float32]:
        thick = part.shape[2]
        if thick not in spreads:
            spreads.clear()
            spreads[thick] = Spread(Grid((*grid.shape[:2], thick), grid.pitch), diffusion, here)
        shape = contrast(spreads[thick], here.upload(part), background, ridge=ridge, iterations=iterations)
        dose = background + (1.0 - background) * shape.numpy()[:, :, margin : margin + keep]
        return np.maximum(dose, 0.0).astype(np.float32)

    for slab in slabs:
        if slab.ndim != 3 or slab.shape[:2] != grid.shape[:2]:
            raise ShapeMismatch(f"a slab has shape {slab.shape}; expected {(*grid.shape[:2], 'any')} = [x, y, z]")
        column = np.concatenate([column, np.asarray(slab, np.float32)], axis=2)
        while column.shape[2] >= block + 2 * margin:
            yield solved(column[:, :, : block + 2 * margin], block)
            column = column[:, :, block:]
    column = np.concatenate([column, np.zeros((*grid.shape[:2], margin), np.float32)], axis=2)
    while (left := column.shape[2] - 2 * margin) > 0:
        yield solved(column[:, :, : min(block, left) + 2 * margin], min(block, left))
        column = column[:, :, min(block, left) :]


def _on(spread: Spread, fraction: DeviceArray | npt.NDArray[np.floating]) -> DeviceArray:
    if tuple(fraction.shape) != spread.domain.shape:
        raise ShapeMismatch(f"fractions have shape {tuple(fraction.shape)}; the grid has {spread.domain.shape}")
    if isinstance(fraction, DeviceArray):
        return fraction
    if not np.isfinite(fraction).all():
        raise BadInput("fractions hold numbers that are not finite; expected 0..1")
    return spread.device.upload(np.asarray(fraction))

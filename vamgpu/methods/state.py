"""The state of an optimizer: operator, target, memory of the run, and the kernel launches that all methods share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from math import inf, isfinite
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, OutOfMemory
from vamgpu.kernels.dwell import weigh_poses
from vamgpu.kernels.filter import filter_rows, filtered_step
from vamgpu.kernels.pointwise import disc
from vamgpu.kernels.update import apply_penalty, fill_background, multiply
from vamgpu.losses.band import MOST
from vamgpu.losses.loss import Loss
from vamgpu.methods.best_light import Best
from vamgpu.methods.method import Criterion
from vamgpu.methods.part import reach_of, uploaded
from vamgpu.methods.ramp import Taps
from vamgpu.operators.compose import NO_FLOOR, combine
from vamgpu.operators.protocol import Operator
from vamgpu.operators.reductions import EVERYWHERE, dot, extent, extents, folded, parts_for, window
from vamgpu.operators.scenarios import Scenarios
from vamgpu.operators.space import require
from vamgpu.targets.limits import Limits

if TYPE_CHECKING:
    from vamgpu.methods.surface import Beside

UNLIMITED = 3e38
"""A value in float32 that stands for "no limit"."""


@dataclass(frozen=True, eq=False)
class PartialProblem:
    """Conditions under which the light of one segment of a longer print is optimized."""

    rest: DeviceArray  # dose from other light [x, y, z]
    target: DeviceArray  # the target at voxels that count, −1 elsewhere [x, y, z]
    free: DeviceArray  # 1 for angles whose light is optimized, else 0, a table (poses,)
    levels: tuple[float, float] | None = None  # a and b that are far enough apart; None for as far as possible


class OptimizerState:
    """One run: everything a method may use. ``memory`` outlives the run and suffices to resume it."""

    def __init__(
        self, operator: Operator, target: DeviceArray, memory: dict[str, Any], criterion: Criterion = "window",
        limits: Limits | None = None,
    ) -> None:  # fmt: skip
        self.operator: Operator = operator
        self.target: DeviceArray = target
        self.memory: dict[str, Any] = memory
        self.best: Best = Best(memory, criterion)
        self.iteration = 0  # iterations so far, including those of resumed runs
        self.most_evaluations = inf
        self.partial: PartialProblem | None = None
        self.brightness = inf  # greatest light of a pixel divided by the dose midway between part and void
        self.margin: float = 0.0  # of a ramped target: half width, about one half, of fractions that do not count
        self.most: float = float(memory.get("most", inf))  # greatest light of a pixel, if the method limits it
        self.lit: DeviceArray | None = None  # 1 for pixels that may be lit, else 0, if the method keeps some dark
        self.device: Device = operator.device
        self.reach: float = reach_of(operator.grid)
        self.evaluations: float = float(memory.get("evaluations", 0.0))
        self.limits = limits  # by which the operator's doses are already scaled
        weighted = limits is not None and limits.weighted
        self.weight: DeviceArray | None = self.field(limits.weight) if limits is not None and weighted else None

    @cached_property
    def _squares(self) -> tuple[DeviceArray, DeviceArray] | None:
        """Squares of the limits, because the operator's doses are divided by them once, and an array for products."""
        if self.limits is None:
            return None
        return self.device.upload((self.limits.dose**2).astype(np.float32)), self.volume()

    def volume(self) -> DeviceArray:
        """An uninitialized volume."""
        return self.device.empty(self.operator.domain.shape)

    def sinogram(self) -> DeviceArray:
        """An uninitialized sinogram."""
        return self.device.empty(self.operator.range.shape)

    def has_room(self, volumes: int, sinograms: int) -> bool:
        """Whether the device has memory for this number of further fields."""
        try:
            fields = [self.volume() for _ in range(volumes)] + [self.sinogram() for _ in range(sinograms)]
        except OutOfMemory:
            return False
        del fields
        return True

    def evaluation_mask(self) -> np.ndarray:
        """1 for voxels that count, else 0, float32."""
        if self.partial is not None:
            return (self.partial.target.numpy() >= 0.0).astype(np.float32)
        shape = self.target.shape
        near = disc(shape[0], shape[1], self.reach)[:, :, None]
        return np.broadcast_to(near, shape).astype(np.float32)

    def field(self, values: Any) -> DeviceArray | None:
        """Weights of voxels as a volume on the device; None stays None. Raises `ShapeMismatch`."""
        if values is None:
            return None
        require(self.operator.domain, values, "the weight")
        field = values if isinstance(values, DeviceArray) else uploaded(self.device, values, "the weight")
        low, high = extent(field)
        if not (low >= 0.0 and 0.0 < high < MOST):
            raise BadInput(
                f"the weight reaches from {low:g} to {high:g}; expected values ≥ 0, some above 0, all below {MOST:g}"
            )
        return field

    def buffer(self, name: str) -> DeviceArray:
        """A field of the run's memory."""
        return self.memory[name]

    def number(self, name: str, default: float = 0.0) -> float:
        """A number of the run's memory."""
        return float(self.memory.get(name, default))

    def project(self, volume: DeviceArray, out: DeviceArray, beside: Beside | None = None) -> None:
        """out = A volume, plus the projection of cells beside it; half an evaluation."""
        self._count(lambda: self.operator(volume, out=out) if beside is None else beside.project(volume, out))

    def project_scaled(self, model: DeviceArray, out: DeviceArray) -> None:
        """`project` a model, each voxel multiplied by its own limit; half an evaluation."""
        if self._squares is not None:
            squares, scaled = self._squares
            self.device.launch(multiply, x=squares, y=model, out=scaled)
            model = scaled
        self.project(model, out)

    def expose(self, light: DeviceArray, out: DeviceArray, beside: Beside | None = None) -> None:
        """out = Aᵀ light, the dose; half an evaluation. In a partial problem, the dose of other light is added."""
        self._count(lambda: self.operator.T(light, out=out) if beside is None else beside.expose(light, out))
        if self.partial is not None:
            combine(1.0, out, 1.0, self.partial.rest, out)

    def _count(self, half: Callable[[], Any]) -> None:
        """Count half an evaluation; for several scenarios, the number that their operator really made."""
        several = self.operator if isinstance(self.operator, Scenarios) else None
        before = several.projections if several else 0.0
        half()
        self.evaluations += several.projections - before if several else 0.5
        self.memory["evaluations"] = self.evaluations

    def affords(self, evaluations: float) -> bool:
        """Whether this number of further projector evaluations stays within the run's limit."""
        return self.evaluations + evaluations * getattr(self.operator, "cost", 1.0) <= self.most_evaluations

    def offer(self, loss: float, window: float, made: int) -> bool:
        """Store ``light`` in memory if it is the best so far."""
        return self.best.offer(self.buffer("light"), loss, window, self.iteration + made)

    def window(self, dose: DeviceArray) -> tuple[float, float]:
        """Strict window of a dose, −1 if dark or not finite, and the greatest dose; without a void nothing leaks."""
        least, leak, greatest = self.extremes(dose)
        if not (isfinite(least) and leak < inf and 0.0 < greatest < inf):
            return -1.0, max(greatest, 1e-30) if isfinite(greatest) else 1.0
        return (least - max(leak, 0.0)) / greatest, greatest

    def extremes(self, dose: DeviceArray) -> tuple[float, float, float]:
        """Least dose inside the part, greatest dose outside, and the greatest anywhere, over voxels that count."""
        partial = self.partial
        if partial is None:
            return window(dose, self.target, self.reach, self.margin)
        (least, high), (_, leak) = extents(dose, partial.target, [(0.5, inf), (-0.5, 0.5)], EVERYWHERE)
        if partial.levels is not None:
            least, leak = min(least, partial.levels[0]), max(leak, partial.levels[1])
        return min(least, 1.0), leak, max(high, leak, 1.0 if partial.levels is not None else 0.0)

    @cached_property
    def _target_square(self) -> float:
        return dot(self.target, self.target)

    def part_mean(self, dose: DeviceArray) -> float:
        """Ratio of dose to target in the part, where each voxel is weighted by its target."""
        return max(dot(dose, self.target) / max(self._target_square, 1e-30), 1e-30)

    def loss(self, dose: DeviceArray, loss: Loss) -> float:
        """The loss of a dose; the dose is overwritten by the gradient."""
        loss = loss if self.weight is None else loss.weighted(self.weight)
        return loss.value_and_gradient(dose, self.target, dose, self.reach)

    combine: ClassVar[Callable[..., DeviceArray]] = staticmethod(combine)

    def scale(self, factor: float, x: DeviceArray, out: DeviceArray) -> None:
        """out = factor·x."""
        combine(factor, x, 0.0, x, out)

    def fill_background(self, background: float, out: DeviceArray) -> None:
        """out = the target over a background that fills the cylinder."""
        self.device.launch(fill_background, target=self.target, low=background, high=1.0, reach=self.reach, model=out)

    def filter(self, sinogram: DeviceArray, taps: Taps, out: DeviceArray, floor: float = NO_FLOOR) -> None:
        """out = max(floor, sinogram filtered along r), multiplied by the balance of its angle."""
        self.device.launch(
            filter_rows, sinogram=sinogram, taps=taps.table, stride=taps.stride, floor=floor, filtered=out
        )
        self._balance(out, taps)

    def _balance(self, images: DeviceArray, taps: Taps) -> None:
        if taps.balance is not None:
            self.device.launch(weigh_poses, light=images, times=taps.balance, weighted=images)

    def apply_penalty(
        self, light: DeviceArray, gradient: DeviceArray, weight: float = 0.0, power: float = 1.0, hold: bool = True
    ) -> float:
        """Add a penalty weight·Σ light^power to a gradient, and hold dark and brightest light; return the penalty."""
        parts = parts_for(apply_penalty, gradient)
        how = {"weight": weight, "power": power, "hold": int(hold), "most": min(self.most, UNLIMITED)}
        self.device.launch(apply_penalty, light=light, **how, gradient=gradient, parts=parts)
        return folded(parts) if weight else 0.0

    def step(self, gradient: DeviceArray, taps: Taps, step: float, momentum: float) -> None:
        """One filtered, accelerated step of ``light`` and ``ahead`` in memory; may balance the gradient in place."""
        self._balance(gradient, taps)
        self.device.launch(
            filtered_step,
            gradient=gradient,
            taps=taps.table,
            stride=taps.stride,
            step=step,
            momentum=momentum,
            light=self.buffer("light"),
            ahead=self.buffer("ahead"),
        )

"""Two thresholds with a ramp between them across the surface of the part."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.geometry import positive
from vamgpu.kernels.loss import ramp_loss
from vamgpu.kernels.signature import Kernel
from vamgpu.losses.band import check_thresholds
from vamgpu.losses.loss import KernelLoss
from vamgpu.operators.compose import combine
from vamgpu.operators.reductions import EVERYWHERE

PASSES, ALIKE = 12, 1e-6
"""Most passes over the voxels to find the step of the thresholds, and the change at which it counts as found."""


@dataclass(frozen=True)
class Ramp(KernelLoss):
    """Loss Σ w·e²/2 of a dose D at depth d below the surface of the part, d < 0 outside.

        t(d) = outside + (inside − outside)·clip(½ + d / 2s, 0, 1)
        e = min(0, D − t) + max(0, D − most) in the part,  e = max(0, D − t) outside

    Two thresholds need a jump of the dose at the surface, which pixels of width s cannot make.
    `vamgpu.methods.surface.across` makes the target from fractions: clip(½ + d / 2s, 0, 1). With a cost c, half the
    step h = (inside − outside)/2 grows about its middle to h' = h … steepest·h, for the least loss plus
    c·(steepest·h − h'); ``most`` rises by h' − h.

    Args:
        outside: Greatest dose at a distance s outside the surface, relative to the part's.
        inside: Least dose at a depth s inside, relative to the part's.
        most: Greatest dose in the part, relative to the part's.
        weight: Weight w of each voxel [x, y, z], NumPy or on the device; None for 1.
        steepest: Greatest ratio by which the step grows; less where thresholds would be negative.
        cost: Loss for each unit of dose by which half the step is less than greatest, ≥ 0; 0 keeps the step.

    Raises:
        BadInput: The values are not 0 ≤ outside < inside ≤ most, steepest ≥ 1 and cost ≥ 0.
    """

    outside: float
    inside: float
    most: float = 1.0
    weight: Any = field(default=None, compare=False, repr=False)
    steepest: float = 1.0
    cost: float = 0.0
    sums: ClassVar[tuple[str, ...]] = ("parts", "slopes", "bends")

    def __post_init__(self) -> None:
        check_thresholds(self.outside, self.inside, self.most)
        positive("cost", self.cost, zero=True)
        if not positive("steepest", self.steepest) >= 1.0:
            raise BadInput(f"steepest is {self.steepest!r}; expected a ratio ≥ 1: 1 keeps the step of the thresholds")

    def launched(self, device: Device) -> tuple[Kernel, dict[str, Any]]:
        return ramp_loss, self._apart(0.0) | {"hold": 0}

    @property
    def coupling(self) -> str:
        return "the step of the thresholds depends on all voxels" if self.cost else super().coupling

    def value_and_gradient(
        self, dose: DeviceArray, target: DeviceArray, out: DeviceArray, reach: float = EVERYWHERE
    ) -> float:
        if not self.cost:
            return super().value_and_gradient(dose, target, out, reach)
        if out is not dose:
            combine(1.0, dose, 0.0, dose, out)
        least, middle = 0.5 * (self.inside - self.outside), 0.5 * (self.inside + self.outside)
        half = greatest = max(least, min(self.steepest * least, middle))
        for _ in range(PASSES):  # Newton's method, from above because the slope is almost convex
            _, slope, bend = self.passed(out, target, reach, **self._apart(half - least), hold=1)
            before, half = half, min(max(half - (slope - self.cost) / max(bend, 1e-30), least), greatest)
            if abs(half - before) < ALIKE:
                break
        return self.passed(out, target, reach, **self._apart(half - least))[0] + self.cost * (greatest - half)

    def _apart(self, more: float) -> dict[str, Any]:
        """Thresholds farther from their middle."""
        return {"outside": max(self.outside - more, 0.0), "inside": self.inside + more, "most": self.most + more}

    def curvature(self) -> float:
        return 1.0

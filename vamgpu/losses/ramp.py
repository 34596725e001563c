"""Two thresholds with a ramp between them across the surface of the part."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from vamgpu.backend.device import Device
from vamgpu.kernels.loss import ramp_loss
from vamgpu.kernels.signature import Kernel
from vamgpu.losses.band import check_thresholds
from vamgpu.losses.loss import KernelLoss


@dataclass(frozen=True)
class Ramp(KernelLoss):
    """Loss Σ w·e²/2 of a dose D at depth d below the surface of the part, d < 0 outside.

        t(d) = outside + (inside − outside)·clip(½ + d / 2s, 0, 1)
        e = min(0, D − t) + max(0, D − most) in the part,  e = max(0, D − t) outside

    Two thresholds need a jump of the dose at the surface, which pixels of width s cannot make.
    `vamgpu.methods.surface.across` makes the target from fractions: clip(½ + d / 2s, 0, 1).

    Args:
        outside: Greatest dose at a distance s outside the surface, relative to the part's.
        inside: Least dose at a depth s inside, relative to the part's.
        most: Greatest dose in the part, relative to the part's.
        weight: Weight w of each voxel [x, y, z], NumPy or on the device; None for 1.

    Raises:
        BadInput: The values are not 0 ≤ outside < inside ≤ most.
    """

    outside: float
    inside: float
    most: float = 1.0
    weight: Any = field(default=None, compare=False, repr=False)

    def __post_init__(self) -> None:
        check_thresholds(self.outside, self.inside, self.most)

    def launched(self, device: Device) -> tuple[Kernel, dict[str, Any]]:
        return ramp_loss, {"outside": self.outside, "inside": self.inside, "most": self.most}

    def curvature(self) -> float:
        return 1.0

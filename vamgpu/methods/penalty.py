"""Penalty minimization: a penalty for every voxel on the wrong side of its threshold."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from vamgpu.losses.band import Band
from vamgpu.losses.loss import Loss
from vamgpu.methods.descent import ByDescent
from vamgpu.methods.papers import PENALTY


@dataclass(frozen=True)
class PenaltyMinimization(ByDescent):
    """Penalizes only voxels on the wrong side of their threshold.

    As published, with light g, dose d = Aᵀg and the penalties ρ₁ of a void voxel and ρ₂ of a part voxel:

        minimize ρ₁·Σ_void max(0, d − outside) + ρ₂·Σ_part max(0, inside − d) over g ≥ 0

    The derivative with respect to dose is ρ₁ or −ρ₂ if a voxel is wrong, otherwise 0. It is projected, and negative
    light is set to 0. There is no upper threshold in the part. The run ends when no voxel is wrong.

    What differs here: subgradient steps whose length is found as in `BCLP` (share, growth; steps that raise the loss
    are undone and halved), starting from filtered back projection; no buffer zone around the part.

    Args:
        outside: Threshold of the void in units of the part's dose.
        inside: Threshold of the part, in units of the part's dose.
        penalty: Weight of a void voxel and of a part voxel, (ρ₁, ρ₂).
        share: Relative change of the light in the first step, > 0.
        growth: Factor from one step to the next, ≥ 1.
        momentum: Share of the last step that is added to the next, in [0, 1).

    Raises:
        BadInput: A value is out of its range, or the thresholds are not 0 ≤ outside < inside ≤ 1.
    """

    outside: float = 0.75
    inside: float = 0.9
    penalty: tuple[float, float] = (1.0, 1.0)
    share: float = 0.05
    growth: float = 1.1
    momentum: float = 0.0
    papers: ClassVar[tuple[str, ...]] = (PENALTY,)
    iterations: ClassVar[int] = 20

    def __post_init__(self) -> None:
        Band.thresholds(self.outside, self.inside)
        super().__post_init__()

    @property
    def loss(self) -> Loss:
        """The sum of penalties."""
        far = 10.0  # an upper limit that no dose reaches, low enough for float32
        center, slack = (0.5 * self.outside, 0.5 * (self.inside + far)), (0.5 * self.outside, 0.5 * (far - self.inside))
        return Band(center, slack, self.penalty, 1.0, binary=True)

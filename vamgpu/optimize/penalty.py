"""Penalty minimization: a price for every voxel on the wrong side of its threshold."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from vamgpu.errors import BadInput
from vamgpu.optimize.band import Band
from vamgpu.optimize.descent import Descent
from vamgpu.optimize.fbp import filtered_light
from vamgpu.optimize.method import Steps
from vamgpu.optimize.papers import PENALTY
from vamgpu.optimize.ramp import identity
from vamgpu.optimize.work import Work


@dataclass(frozen=True)
class PenaltyMinimization:
    """Projected subgradient descent on Σ max(0, dose − outside) out of the part + Σ max(0, inside − dose) in it.

    outside, inside: thresholds in units of the part's dose.  price: of a void voxel, of a part voxel.  share, growth,
    momentum: as in `GradientDescent`.  Raises `BadInput`.
    """

    outside: float = 0.75
    inside: float = 0.9
    price: tuple[float, float] = (1.0, 1.0)
    share: float = 0.05
    growth: float = 1.1
    momentum: float = 0.0
    papers: ClassVar[tuple[str, ...]] = (PENALTY,)
    iterations: ClassVar[int] = 20

    def __post_init__(self) -> None:
        Band.thresholds(self.outside, self.inside)
        if not (min(self.price) >= 0 and self.share > 0 and self.growth >= 1 and 0 <= self.momentum < 1):
            raise BadInput(f"{self!r}: wanted prices ≥ 0, share > 0, growth ≥ 1 and 0 ≤ momentum < 1")

    def steps(self, work: Work) -> Steps:
        if "light" not in work.memory:
            filtered_light(work, work.volume())
        far = 10.0  # a ceiling no dose reaches, low enough for float32
        center, slack = (0.5 * self.outside, 0.5 * (self.inside + far)), (0.5 * self.outside, 0.5 * (far - self.inside))
        band = Band(center, slack, self.price, 1.0, binary=True)
        taps = identity(work.operator)
        yield from Descent(band, taps, share=self.share, growth=self.growth, momentum=self.momentum).steps(work)

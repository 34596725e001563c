"""Gradient descent of computed axial lithography."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from vamgpu.errors import BadInput
from vamgpu.optimize.band import Band
from vamgpu.optimize.descent import Descent
from vamgpu.optimize.fbp import filtered_light
from vamgpu.optimize.method import Steps
from vamgpu.optimize.papers import CAL
from vamgpu.optimize.ramp import identity
from vamgpu.optimize.response import Linear, Response
from vamgpu.optimize.work import Work


@dataclass(frozen=True)
class GradientDescent:
    """Projected gradient descent on Σ (response(dose) − target)² / 2, from filtered back projection.

    share: change of the light in the first step over the light.  growth: of the step from one to the next; it halves
    where the loss rises twice.  momentum: share of the last step that is added to the next.  Raises `BadInput`.
    """

    share: float = 0.05
    growth: float = 1.1
    momentum: float = 0.0
    response: Response = Linear()
    papers: ClassVar[tuple[str, ...]] = (CAL,)
    iterations: ClassVar[int] = 20

    def __post_init__(self) -> None:
        if not (self.share > 0 and self.growth >= 1 and 0 <= self.momentum < 1):
            raise BadInput(f"{self!r}: wanted share > 0, growth ≥ 1 and 0 ≤ momentum < 1")

    def steps(self, work: Work) -> Steps:
        if "light" not in work.memory:
            filtered_light(work, work.volume())
        band = Band((0.0, 1.0), (0.0, 0.0), (0.5, 0.5), response=self.response)
        taps = identity(work.operator)
        yield from Descent(band, taps, share=self.share, growth=self.growth, momentum=self.momentum).steps(work)

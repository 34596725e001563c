"""Gradient descent of computed axial lithography."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import ClassVar

from vamgpu.errors import BadInput
from vamgpu.methods.band import Band
from vamgpu.methods.descent import Descent
from vamgpu.methods.entropy import CrossEntropy
from vamgpu.methods.fbp import filtered_light
from vamgpu.methods.method import Criterion, Steps
from vamgpu.methods.papers import CAL, CAL_FIRST
from vamgpu.methods.ramp import identity
from vamgpu.methods.response import Logistic, Response
from vamgpu.methods.work import Work


@dataclass(frozen=True)
class GradientDescent:
    """The projected error of a sigmoid of the dose corrects the light, from filtered back projection on.

    As published, with light g, dose d = Aᵀg, target f and the sigmoid M of steepness s about the threshold μ:

        g ← max(0, g − η·A(M(d) − f)),    M(d) = 1 / (1 + exp(−s·(d − μ)))

    The error is projected as it is, without the slope of the sigmoid, so that voxels far on the wrong side count in
    full. That makes A(M(d) − f) the exact gradient of a convex function of light, the cross entropy of M(d) and f over
    s (`CrossEntropy`); it is the loss reported, by which the best light is chosen.

    What differs here: doses are in units of the part's (published: over the greatest dose, with μ chosen anew each
    time), the step η is not fixed but grows, and a step that raises the loss is taken back and halved.

    Args:
        share: Change of the light in the first step over the light, > 0.
        growth: Of the step from one to the next, ≥ 1.
        momentum: Share of the last step that is added to the next, in [0, 1); published: 0.
        response: The sigmoid M.

    Raises:
        BadInput: For values out of these ranges.
    """

    share: float = 0.05
    growth: float = 1.1
    momentum: float = 0.0
    response: Response = Logistic()
    papers: ClassVar[tuple[str, ...]] = (CAL, CAL_FIRST)
    iterations: ClassVar[int] = 20
    cost: ClassVar[float] = 1.0
    criterion: ClassVar[Criterion] = "loss"

    def __post_init__(self) -> None:
        if not (0 < self.share < inf and 1 <= self.growth < inf and 0 <= self.momentum < 1):
            raise BadInput(f"{self!r}: wanted share > 0, growth ≥ 1 and 0 ≤ momentum < 1")

    def steps(self, work: Work) -> Steps:
        if "light" not in work.memory:
            filtered_light(work, work.volume())
        yield from Descent(
            Band((0.0, 1.0), (0.0, 0.0), response=self.response),
            identity(work.operator),
            share=self.share,
            growth=self.growth,
            momentum=self.momentum,
            loss=CrossEntropy(work, self.response),
            guarded=True,
        ).steps(work)

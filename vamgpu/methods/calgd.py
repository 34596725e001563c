"""Gradient descent of computed axial lithography."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from vamgpu.losses.loss import Loss
from vamgpu.losses.response import Logistic, Response
from vamgpu.losses.voxel_loss import cross_entropy
from vamgpu.methods.descent import ByDescent
from vamgpu.methods.papers import CAL, CAL_FIRST


@dataclass(frozen=True)
class GradientDescent(ByDescent):
    """The projected error of a sigmoid of the dose corrects the light, from filtered back projection on.

    As published, with light g, dose d = Aᵀg, target f and the sigmoid M of steepness s about the threshold μ:

        g ← max(0, g − η·A(M(d) − f)),    M(d) = 1 / (1 + exp(−s·(d − μ)))

    The error is projected as it is, without the slope of the sigmoid, so that voxels far on the wrong side count in
    full. That makes A(M(d) − f) the exact gradient of a convex function of light, the cross entropy of M(d) and f over
    s (`cross_entropy`); it is the loss reported, by which the best light is chosen.

    What differs here: doses are in units of the part's (published: over the greatest dose, with μ chosen anew each
    time), the step η is not fixed but grows, and a step that raises the loss is taken back and halved.

    Args:
        share: Relative change of the light in the first step, > 0.
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

    @property
    def loss(self) -> Loss:
        """What the projected error is the gradient of."""
        return cross_entropy(self.response)

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
    """Starts from filtered back projection, and corrects the light by the projected error of a sigmoid of the dose.

    As published, with light g, dose d = Aᵀg, target f and the sigmoid M of steepness s about the threshold μ:

        g ← max(0, g − η·A(M(d) − f)),    M(d) = 1 / (1 + exp(−s·(d − μ)))

    The error is projected without the slope of the sigmoid; voxels far on the wrong side therefore count fully. As a
    result, A(M(d) − f) is the exact gradient of a convex function of light: the cross entropy of M(d) and f divided by
    s (`cross_entropy`). This function is the reported loss, which selects the best light.

    What differs here: doses are in units of the part's (published: divided by the greatest dose, with a new μ in each
    step), the step η grows, and a step that raises the loss is undone and halved.

    Args:
        share: Relative change of the light in the first step, > 0.
        growth: Factor from one step to the next, ≥ 1.
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
        """The loss whose gradient is the projected error."""
        return cross_entropy(self.response)

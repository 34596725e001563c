"""Minimization of any loss from filtered back projection; other methods that minimize a loss are special cases."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, replace
from math import inf
from typing import ClassVar

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.losses.band import Band
from vamgpu.losses.loss import Loss
from vamgpu.methods.exposure import lower
from vamgpu.methods.method import Method, Steps
from vamgpu.methods.minimize import StepRule, check_pairs
from vamgpu.methods.state import OptimizerState

ABOVE = 0.05  # excess dose of a gray body, relative to its own dose, above which it is penalized
STEEP = 10.0  # weight of that penalty, for losses whose steepest derivatives with respect to dose are about 1


@dataclass(frozen=True)
class Descent(Method):
    """Projected gradient steps that minimize any loss of the dose; steps that raise it are undone and halved.

        minimize loss(Aᵀg), g ← max(0, g − η·∂/∂g)

    Args:
        loss: A `vamgpu.losses.Loss`, also your own.
        share: Relative change of the light in the first step, > 0.
        growth: Factor from one step η to the next, ≥ 1.
        momentum: Share of the last step that is added to the next, in [0, 1).
        history: Pairs of sinograms from which L-BFGS finds its directions and steps instead; 0 for none.

    Raises:
        BadInput: For values out of these ranges.
    """

    loss: Loss
    share: float = 0.05
    growth: float = 1.1
    momentum: float = 0.0
    history: int = 0
    takes_start: ClassVar[bool] = True
    iterations: ClassVar[int] = 40

    def __post_init__(self) -> None:
        if not isinstance(self.loss, Loss):
            raise BadInput(f"got {self.loss!r} as loss; expected a Loss, such as VoxelLoss(void=…, part=…)")
        if not (0 < self.share < inf and 1 <= self.growth < inf and 0 <= self.momentum < 1):
            raise BadInput(f"{self!r}: expected share > 0, growth ≥ 1 and 0 ≤ momentum < 1")
        check_pairs(self.history, least=0)

    def steps(self, state: OptimizerState) -> Steps:
        rule = StepRule(share=self.share, growth=self.growth, momentum=self.momentum, back=1.0, history=self.history)
        yield from lower(state, self.loss, rule)


class ByDescent(Method):
    """Base of methods that minimize a loss: `Descent` does it with their share, growth and momentum."""

    share: float
    growth: float
    momentum: float
    takes_start: ClassVar[bool] = True

    @property
    @abstractmethod
    def loss(self) -> Loss:
        """The loss to minimize."""

    def __post_init__(self) -> None:
        self._descent()

    def _descent(self) -> Descent:
        return Descent(self.loss, self.share, self.growth, self.momentum)

    def steps(self, state: OptimizerState) -> Steps:
        held = _held(state)
        descent = self._descent()
        yield from (descent if held is None else replace(descent, loss=descent.loss + held)).steps(state)


def _held(state: OptimizerState) -> Loss | None:
    """Upper limit of gray bodies, which losses for plain parts lack; None without gray bodies."""
    if state.limits is None or not state.limits.gray.any():
        return None
    most = 0.5 + ABOVE
    return Band((0.5, 0.5), (most, most), (STEEP, STEEP), weight=state.limits.gray.astype(np.float32))

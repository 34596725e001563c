"""Any loss lowered from filtered back projection on; the methods whose loss is the purpose are cases of it."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import ClassVar

from vamgpu.errors import BadInput
from vamgpu.losses.loss import Loss
from vamgpu.methods.exposure import Exposure
from vamgpu.methods.fbp import filtered_light
from vamgpu.methods.method import Criterion, Steps
from vamgpu.methods.minimize import Channel, Pace, minimize
from vamgpu.methods.ramp import identity
from vamgpu.methods.work import Work


@dataclass(frozen=True)
class Descent:
    """Projected gradient steps that lower any loss of the dose; steps that raise it are taken back and halved.

        minimize loss(Aᵀg), g ← max(0, g − η·∂/∂g)

    Args:
        loss: A `vamgpu.losses.Loss`, your own included.
        share: Change of the light in the first step over the light, > 0.
        growth: Of the step η from one to the next, ≥ 1.
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
    papers: ClassVar[tuple[str, ...]] = ()
    cost: ClassVar[float] = 1.0
    criterion: ClassVar[Criterion] = "loss"
    iterations: ClassVar[int] = 40

    def __post_init__(self) -> None:
        if not isinstance(self.loss, Loss):
            raise BadInput(f"got {self.loss!r} as loss; wanted a Loss, such as VoxelLoss(void=…, part=…)")
        if not (0 < self.share < inf and 1 <= self.growth < inf and 0 <= self.momentum < 1):
            raise BadInput(f"{self!r}: wanted share > 0, growth ≥ 1 and 0 ≤ momentum < 1")
        if isinstance(self.history, bool) or not isinstance(self.history, int) or self.history < 0:
            raise BadInput(f"history is {self.history!r}; wanted a whole number ≥ 0")

    def steps(self, work: Work) -> Steps:
        if "light" not in work.memory:
            filtered_light(work, work.volume())
        pace = Pace(
            share=self.share, growth=self.growth, momentum=self.momentum, back=1.0, history=self.history
        )  # fmt: skip
        yield from minimize(Exposure(work, self.loss, pace), (Channel(work, identity(work.operator)),), pace)

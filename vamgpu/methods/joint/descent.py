"""Accelerated, preconditioned descent for the light of both colors at once."""

from __future__ import annotations

from typing import Any

from vamgpu.backend.array import DeviceArray
from vamgpu.losses.loss import Loss
from vamgpu.methods.dual.objective import ColorObjective
from vamgpu.methods.joint.models import Model
from vamgpu.methods.method import Steps
from vamgpu.methods.minimize import Channel, StepRule, minimize
from vamgpu.methods.ramp import capped_ramp
from vamgpu.methods.state import OptimizerState

CAP, SPAN = 0.25, 0.25
"""Frequency [cycles per column] beyond which the ramp is level, and share of the columns that it extends over."""
ROUNDS = 6  # number of power iterations for the length of a step
PACE = StepRule(1.0, growth=1.04, shrink=0.6, calm=0.5, back=1.5, possible=True)
"""The first step has the length for the linear model. Later steps grow, because a decaying and depleting resin reacts
more weakly than the first light suggests. If the loss rises, steps become shorter, and then grow half as fast."""


def gains_of(model: Model, target: DeviceArray) -> tuple[float, ...]:
    """Gain of each color, which sets the longest possible steps: `ROUNDS` evaluations each."""
    return tuple(
        Channel(OptimizerState(A, target, {}, "loss"), capped_ramp(A, CAP, SPAN)).gain(ROUNDS) for A in model.operators
    )


class ColorDescent(ColorObjective):
    """Steps that lower the loss of the effective dose of both colors; ``memories`` hold the state to continue."""

    def __init__(
        self, model: Model, target: DeviceArray, loss: Loss, memories: tuple[dict[str, Any], ...], share: float,
        gains: tuple[float, ...] | None = None,
    ) -> None:  # fmt: skip
        resin, turns = model.resin, model.turns
        answers = (turns * resin.visible, turns * abs(resin.subtraction))
        channels = tuple(
            Channel(OptimizerState(A, target, memory, "loss"), capped_ramp(A, CAP, SPAN),
                    portion / (gain * max(answer, 1e-30) ** 2))
            for A, memory, answer, gain, portion in zip(
                model.operators, memories, answers, gains or gains_of(model, target), (1.0 - share, share), strict=True
            )
        )  # fmt: skip
        super().__init__(model, channels, loss)

    def steps(self) -> Steps:
        """Loss and strict window of the effective dose that each step evaluated, or returned to."""
        for record in minimize(self, self.channels, PACE):
            self.state.iteration += 1
            yield record

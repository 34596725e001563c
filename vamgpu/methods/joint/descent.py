"""Accelerated, preconditioned descent of the light of both colors at once."""

from __future__ import annotations

from typing import Any

from vamgpu.backend.array import DeviceArray
from vamgpu.losses.loss import Loss
from vamgpu.methods.joint.models import Model, Pair
from vamgpu.methods.method import Steps
from vamgpu.methods.minimize import Channel, Pace, minimize
from vamgpu.methods.ramp import capped_ramp
from vamgpu.methods.state import OptimizerState

CAP, SPAN = 0.25, 0.25
"""Of the ramp: frequency [cycles a column] beyond which it is level, and share of the columns it reaches over."""
ROUNDS = 6
"""Power iterations for the length of a step."""
PACE = Pace(1.0, growth=1.04, shrink=0.6, calm=0.5, back=1.5, possible=True)
"""The first step is as long as the linear model stands, and later ones grow, for what decays and depletes answers more
weakly than the first light promises; where the loss rises steps are shorter, and then grow half as fast."""


def gains_of(model: Model, target: DeviceArray) -> tuple[float, ...]:
    """What lengths of steps go by, of each color: `ROUNDS` pairs of projections each."""
    return tuple(
        Channel(OptimizerState(A, target, {}, "loss"), capped_ramp(A, CAP, SPAN)).gain(ROUNDS) for A in model.operators
    )


class ColorDescent:
    """The loss of the effective dose of light of both colors, and steps that lower it.

    gains: of each color, that `gains_of` found for these operators or such ones; None finds them.

    The point that momentum carries ahead is cut off at darkness too, so that every dose looked at is that of possible
    light, and the best of it can be returned. ``memories``: of the colors, each with its ``light``; they are enough to
    go on from.
    """

    model: Model
    loss: Loss

    def __init__(
        self, model: Model, target: DeviceArray, loss: Loss, memories: tuple[dict[str, Any], ...], share: float,
        gains: tuple[float, ...] | None = None,
    ) -> None:  # fmt: skip
        self.model = model
        resin, turns = model.resin, model.turns
        answers = (turns * resin.visible, turns * abs(resin.subtraction))
        self.channels: tuple[Channel, ...] = tuple(
            Channel(OptimizerState(A, target, memory, "loss"), capped_ramp(A, CAP, SPAN),
                    portion / (gain * max(answer, 1e-30) ** 2))
            for A, memory, answer, gain, portion in zip(
                model.operators, memories, answers, gains or gains_of(model, target), (1.0 - share, share), strict=True
            )
        )  # fmt: skip
        self.state: OptimizerState = self.channels[0].state
        self.loss = loss.on(self.state.field)

    @property
    def light(self) -> Pair:
        """The light of least loss among those looked at; the first one before any was."""
        return Pair(*(channel.state.memory.get("best", channel.light) for channel in self.channels))

    @property
    def best_iteration(self) -> int:
        """The look, counted from 1, at that light; 0 before any."""
        return self.state.best.iteration

    def steps(self) -> Steps:
        """Loss and strict window of the effective dose that each step looked at, or went back to."""
        for record in minimize(self, self.channels, PACE):
            self.state.iteration += 1
            yield record

    def value(self, carried: float = 0.0) -> tuple[float, float]:
        self._dose = self.model.expose(Pair(*(channel.ahead for channel in self.channels)))
        window, _ = self.state.window(self._dose)
        return self.state.loss(self._dose, self.loss), window

    def gradient(self) -> Pair:
        return self.model.gradient(self._dose)

"""Accelerated, preconditioned descent of the light of both colors at once."""

from __future__ import annotations

from vamgpu.backend.array import DeviceArray
from vamgpu.losses.loss import Loss
from vamgpu.methods.joint.models import Model, Pair
from vamgpu.methods.method import Steps
from vamgpu.methods.minimize import Channel, Pace, minimize
from vamgpu.methods.ramp import capped_ramp
from vamgpu.methods.work import Work

CAP, SPAN = 0.25, 0.25
"""Of the ramp: frequency [cycles a column] beyond which it is level, and share of the columns it reaches over."""
ROUNDS = 6
"""Power iterations for the length of a step."""
PACE = Pace(1.0, growth=1.04, shrink=0.6, calm=0.5, back=1.5, possible=True)
"""The first step is as long as the linear model stands, and later ones grow, for what decays and depletes answers more
weakly than the first light promises; where the loss rises steps are shorter, and then grow half as fast."""


class ColorDescent:
    """The loss of the effective dose of light of both colors, and steps that lower it.

    The point that momentum carries ahead is cut off at darkness too, so that every dose looked at is that of possible
    light, and the best of it can be returned.
    """

    def __init__(self, model: Model, target: DeviceArray, loss: Loss, light: Pair, share: float) -> None:
        self.model, self.loss = model, loss
        resin, turns = model.resin, model.turns
        answers = (turns * resin.visible, turns * abs(resin.subtraction))
        self.channels = tuple(
            self._channel(Work(A, target, {"light": part}, "loss"), portion, answer)
            for A, part, answer, portion in zip(model.operators, light, answers, (1.0 - share, share), strict=True)
        )
        self.work = self.channels[0].work

    @staticmethod
    def _channel(work: Work, portion: float, answer: float) -> Channel:
        plain = Channel(work, capped_ramp(work.operator, CAP, SPAN))
        return Channel(work, plain.taps, portion / (plain.gain(ROUNDS) * max(answer, 1e-30) ** 2))

    @property
    def light(self) -> Pair:
        """The light of least loss among those looked at; the first one before any was."""
        return Pair(*(channel.work.memory.get("best", channel.light) for channel in self.channels))

    @property
    def best_iteration(self) -> int:
        """The look, counted from 1, at that light; 0 before any."""
        return self.work.best.iteration

    def steps(self) -> Steps:
        """Loss and strict window of the effective dose that each step looked at, or went back to."""
        for record in minimize(self, self.channels, PACE):
            self.work.iteration += 1
            yield record

    def value(self, carried: float = 0.0) -> tuple[float, float]:
        self._dose = self.model.expose(Pair(*(channel.ahead for channel in self.channels)))
        window, _ = self.work.window(self._dose)
        return self.work.loss(self._dose, self.loss), window

    def gradient(self) -> Pair:
        return self.model.gradient(self._dose)

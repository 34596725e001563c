"""Two sinograms that are never negative, in the sense of least squares; for volumes of any size."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar, cast

from vamgpu.backend.array import DeviceArray
from vamgpu.chemistry.species import PAPER
from vamgpu.errors import BadInput
from vamgpu.losses.band import Band
from vamgpu.losses.loss import Loss
from vamgpu.methods.dual.colors import Pass, constant
from vamgpu.methods.dual.passes import DualState, Rule
from vamgpu.methods.minimize import Channel, Pace, minimize
from vamgpu.methods.papers import NESTEROV, RAMP, RESTART, TWO_METRIC
from vamgpu.methods.ramp import capped_ramp, identity
from vamgpu.methods.state import OptimizerState
from vamgpu.operators.compose import combine
from vamgpu.operators.linear import LinearOperator
from vamgpu.operators.projection import Projection
from vamgpu.operators.reductions import EVERYWHERE
from vamgpu.operators.ring_projection import RingProjection

SPAN = 0.25
"""Share of the columns that the preconditioner reaches over."""
ROUNDS = 8
"""Power iterations for the length of a step."""


@dataclass(frozen=True)
class LeastSquares(Rule):
    """Least ½‖visible dose − strength·UV dose − design‖² over light ≥ 0, by accelerated projected gradients.

    Each color has its own operator and its exact transpose; a capped ramp along r preconditions both, as in
    `ProcessWindow`, where the operator is a `Projection`. An iteration is two projector evaluations.

    Args:
        iterations: In all.
        below: Dose by which a voxel out of the part may fall under zero at no cost (an inhibited void need not be
            exactly at zero).
        cost: Of light, per unit, added to the loss for both colors: keeps the same light from being sent twice with
            opposite effect.
        cap: Frequency [cycles per column] beyond which the ramp is level.

    Raises:
        BadInput: A value is out of its range.
    """

    iterations: int = 60
    below: float = 0.0
    cost: float = 0.0
    cap: float = 0.25
    papers: ClassVar[tuple[str, ...]] = (PAPER, NESTEROV, RESTART, RAMP, TWO_METRIC)

    def __post_init__(self) -> None:
        if self.iterations < 1 or not self.below >= 0 or not self.cost >= 0 or not 0 < self.cap <= 0.5:
            raise BadInput(f"{self!r}: expected iterations ≥ 1, below ≥ 0, cost ≥ 0 and 0 < cap ≤ 0.5")

    def steps(self, state: DualState) -> Iterator[Pass]:
        difference = _Difference(state, self)
        # half of what the gains allow: gradients held at dark light have gaps, which the ramp turns into coarse light
        pace = Pace(0.5 / difference.gain(), soon=3.0, possible=True)
        for _ in zip(range(self.iterations), minimize(difference, difference.channels, pace)):  # noqa: B905
            state.light, state.uv = (channel.state.memory.get("best", channel.light) for channel in difference.channels)
            yield difference.record


class _Difference:
    """The square error of the difference of two doses, and what the light of both costs."""

    def __init__(self, state: DualState, method: LeastSquares) -> None:
        self.state, self.cost, colors = state, method.cost, state.colors
        self.loss: Loss = Band((-0.5 * method.below, 1.0), (0.5 * method.below, 0.0), (0.5, 0.5))
        self.channels = tuple(self._channel(operator, method.cap) for operator in (colors.visible, colors.uv))
        self.signs = (1.0, -colors.strength)
        self.dose, self.under, self.over = state.volume(), state.volume(), state.volume()
        self.gradients = (state.sinogram(), state.sinogram())

    def _channel(self, operator: LinearOperator, cap: float) -> Channel:
        design, projector = self.state.design, cast(Any, operator)
        state = OptimizerState(projector, design, {"light": constant(0.0, operator.range.shape, design)}, "loss")
        if self.state.colors.whole:
            state.reach = EVERYWHERE
        ramped = isinstance(operator, Projection | RingProjection)
        return Channel(state, capped_ramp(projector, cap, SPAN) if ramped else identity(projector))

    def gain(self) -> float:
        """Of both colors together."""
        self.state.evaluations += ROUNDS * len(self.channels)
        gains = (channel.gain(ROUNDS) * sign**2 for channel, sign in zip(self.channels, self.signs, strict=True))
        return sum(gains)

    def value(self, carried: float = 0.0) -> tuple[float, float]:
        state, lead = self.state, self.channels[0].state
        for channel, dose in zip(self.channels, (self.dose, self.under), strict=True):
            state.expose(channel.state.operator, channel.ahead, dose)
        combine(1.0, self.dose, self.signs[1], self.under, self.dose)
        self.record = state.compare(self.dose, state.design, self.under, self.over)
        loss = lead.loss(self.dose, self.loss)
        for channel, sign, gradient in zip(self.channels, self.signs, self.gradients, strict=True):
            channel.state.operator(self.dose, out=gradient)
            state.evaluations += 0.5
            combine(sign, gradient, 0.0, gradient, gradient)
            loss += lead.apply_penalty(channel.ahead, gradient, self.cost, hold=False)
        return loss, 0.0

    def gradient(self) -> tuple[DeviceArray, DeviceArray]:
        return self.gradients

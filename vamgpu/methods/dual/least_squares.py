"""Two sinograms that are never negative, by least squares; for volumes of any size."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar, cast

from vamgpu.chemistry.species import PAPER
from vamgpu.errors import BadInput
from vamgpu.losses.band import Band
from vamgpu.methods.dual.colors import Pair, Pass, constant
from vamgpu.methods.dual.objective import ColorObjective
from vamgpu.methods.dual.passes import DualState, Rule
from vamgpu.methods.minimize import Channel, StepRule, minimize
from vamgpu.methods.papers import NESTEROV, RAMP, RESTART, TWO_METRIC
from vamgpu.methods.ramp import capped_ramp, identity
from vamgpu.methods.state import OptimizerState
from vamgpu.operators.linear import LinearOperator
from vamgpu.operators.projection import Projection
from vamgpu.operators.reductions import EVERYWHERE
from vamgpu.operators.ring_projection import RingProjection

SPAN = 0.25  # share of the columns that the preconditioner extends over
ROUNDS = 8  # number of power iterations for the length of a step


@dataclass(frozen=True)
class LeastSquares(Rule):
    """Minimize ½‖visible dose − strength·UV dose − design‖² over light ≥ 0, by accelerated projected gradients.

    Each color has its own operator and its exact transpose. If the operator is a `Projection`, a capped ramp along r
    preconditions both colors. An iteration is two projector evaluations.

    Args:
        iterations: Total number of iterations.
        below: Negative dose that a voxel outside the part may have without a penalty (an inhibited void need not be
            exactly zero).
        cost: Weight of the light of both colors in the loss, per unit; it avoids that the same light is sent twice with
            opposite effects.
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
        state.evaluations += ROUNDS * len(difference.channels)
        signs = (1.0, state.colors.strength)
        gain = sum(each.gain(ROUNDS) * sign**2 for each, sign in zip(difference.channels, signs, strict=True))
        # half of the safe step: gradients have gaps where light is held dark, and the ramp turns gaps into coarse light
        pace = StepRule(0.5 / gain, soon=3.0, possible=True)
        for _ in zip(range(self.iterations), minimize(difference, difference.channels, pace)):  # noqa: B905
            state.light, state.uv = difference.light
            yield difference.record


class _Difference(ColorObjective):
    """The square error of the difference of two doses, and the cost of the light of both colors."""

    def __init__(self, state: DualState, method: LeastSquares) -> None:
        loss = Band((-0.5 * method.below, 1.0), (0.5 * method.below, 0.0), (0.5, 0.5))
        operators = (state.colors.visible, state.colors.uv)
        super().__init__(state.colors, tuple(_channel(state, A, method.cap) for A in operators), loss)
        self.run, self.cost = state, method.cost
        self.under, self.over = state.volume(), state.volume()

    def value(self, carried: float = 0.0) -> tuple[float, float]:
        dose = self.model.expose(self.ahead)
        self.run.evaluations += 1.0
        self.record = self.run.compare(dose, self.run.target, self.under, self.over)
        loss = self.state.loss(dose, self.loss)
        self.slopes = self.model.gradient(dose)
        self.run.evaluations += 1.0
        for light, slope in zip(self.ahead, self.slopes, strict=True):
            loss += self.state.apply_penalty(light, slope, self.cost, hold=False)
        return loss, 0.0

    def gradient(self) -> Pair:
        return self.slopes


def _channel(run: DualState, operator: LinearOperator, cap: float) -> Channel:
    projector = cast(Any, operator)
    state = OptimizerState(projector, run.target, {"light": constant(0.0, operator.range.shape, run.target)}, "loss")
    if run.colors.whole:
        state.reach = EVERYWHERE
    ramped = isinstance(operator, Projection | RingProjection)
    return Channel(state, capped_ramp(projector, cap, SPAN) if ramped else identity(projector))

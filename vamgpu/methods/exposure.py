"""Objective for one set of light: the loss of its dose, and the penalty of bright light."""

from __future__ import annotations

from math import inf
from typing import TYPE_CHECKING

from vamgpu.backend.array import DeviceArray
from vamgpu.losses.loss import Loss
from vamgpu.methods.fbp import filtered_light
from vamgpu.methods.method import Steps
from vamgpu.methods.minimize import Channel, StepRule, minimize
from vamgpu.methods.ramp import identity
from vamgpu.methods.state import OptimizerState
from vamgpu.operators.compose import capped, combine
from vamgpu.operators.reductions import dot

if TYPE_CHECKING:
    from vamgpu.methods.surface import Beside


class DoseObjective:
    """The loss of the dose Aᵀg of light g, plus penalty·Σ g^power; a value or a gradient takes half an evaluation."""

    def __init__(
        self, state: OptimizerState, loss: Loss, rule: StepRule, *, penalty: tuple[float, float] = (0.0, 1.0),
        rest: DeviceArray | None = None, beside: Beside | None = None, dose: DeviceArray | None = None,
        gradient: DeviceArray | None = None, windows: bool = True,
    ) -> None:  # fmt: skip
        self.state: OptimizerState = state
        self.loss: Loss = loss.on(state.field)
        self.rule: StepRule = rule
        self.penalty: tuple[float, float] = penalty
        self.rest: DeviceArray | None = rest
        self._beside = beside
        self.dose: DeviceArray = state.volume() if dose is None else dose
        if rule.history and "gradient" not in state.memory:
            state.memory["gradient"] = state.sinogram()
        kept = state.memory.get("gradient") if rule.history else gradient
        self._gradient = state.sinogram() if kept is None else kept
        self._at = "light" if rule.history else "ahead"
        self._projected, self._windows = False, windows

    def value(self, carried: float = 0.0) -> tuple[float, float]:
        state, rule, self._projected = self.state, self.rule, False
        state.expose(state.buffer(self._at), self.dose, self._beside)
        if self.rest is not None:
            combine(1.0, self.dose, 1.0, self.rest, self.dose)
        held = self._dose_of_light(carried) if self._windows or rule.back <= 1.0 else self.dose
        window = state.window(held)[0] if self._windows and not rule.fixed else 0.0
        loss = state.loss(self.dose, self.loss) + self._bright()
        loss += self._beside.value() if self._beside is not None else 0.0
        if rule.back <= 1.0 and loss > 0.0:
            self.gradient()  # also if the step is undone: an iteration is one evaluation
        if rule.back <= 1.0 and held is not self.dose:  # the relevant loss is that of the current light
            state.scale(1.0, held, self.dose)
            loss = state.loss(self.dose, self.loss)
        return loss, window

    def gradient(self) -> tuple[DeviceArray]:
        if not self._projected:
            self.state.project(self.dose, self._gradient, self._beside)
            self._bright()
            self._projected = True
        return (self._gradient,)

    def _bright(self) -> float:
        """Penalty of the light; its derivative is added to the gradient after this."""
        penalty, power = self.penalty
        if not penalty:
            return 0.0
        return self.state.apply_penalty(self.state.buffer(self._at), self._gradient, penalty, power, hold=False)

    def _dose_of_light(self, carried: float) -> DeviceArray:
        """Dose of ``light`` from that of ``ahead`` = light + m·(light − previous light)."""
        rule, memory, state = self.rule, self.state.memory, self.state
        if rule.history or rule.fixed or rule.momentum == 0.0:
            return self.dose
        if "dose" not in memory:
            memory["dose"], carried = state.volume(), 0.0
        dose = state.buffer("dose")
        if carried:
            combine(1.0 / (1.0 + carried), self.dose, carried / (1.0 + carried), dose, dose)
        else:  # new memory may contain NaN
            state.scale(1.0, self.dose, dose)
        return dose


def lower(state: OptimizerState, loss: Loss, rule: StepRule, *, efficiency: float = 0.0, power: float = 1.0) -> Steps:
    """Minimize a loss of the dose, from filtered back projection or from the light in the state's memory."""
    memory = state.memory
    if "light" not in memory:
        filtered_light(state, state.volume())
    if state.most < inf:
        capped(state.buffer("light"), state.most)
    if efficiency and "penalty" not in memory:
        bright = state.apply_penalty(state.buffer("light"), state.sinogram(), 1.0, power, hold=False)
        memory["penalty"] = efficiency * dot(state.target, state.target) / max(bright, 1e-60)
    exposure = DoseObjective(state, loss, rule, penalty=(state.number("penalty"), power))
    yield from minimize(exposure, (Channel(state, identity(state.operator)),), rule)

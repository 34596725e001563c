"""Descent for every loss: steps that keep light ≥ 0, with momentum, restarts and a memory for resuming."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf
from typing import Protocol

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.errors import BadInput
from vamgpu.kernels.update import multiply
from vamgpu.losses.loss import Loss
from vamgpu.methods.method import Steps
from vamgpu.methods.pairs import Pairs
from vamgpu.methods.ramp import Taps
from vamgpu.methods.state import OptimizerState
from vamgpu.operators.compose import capped, combine
from vamgpu.operators.reductions import dot, dots

RETREATS = 24  # number of successive returns to the best light, each with half the step, after which the method stops
TRIES = 12  # number of lengths that a line search tries


def check_pairs(history: int, least: int = 1) -> None:
    """Raise `BadInput` for a history that is not a number of pairs."""
    if isinstance(history, bool) or not isinstance(history, int) or history < least:
        raise BadInput(f"history is {history!r}; expected a whole number of pairs ≥ {least}, such as 5")


class Objective(Protocol):
    """Objective for light: mainly the loss of its dose."""

    loss: Loss

    def value(self, carried: float = 0.0) -> tuple[float, float]:
        """Loss and strict window of the current light, or of light ``ahead`` by ``carried`` of the last step."""
        ...

    def gradient(self) -> Sequence[DeviceArray]:
        """Derivatives of the loss, last evaluated ahead, by the light of each channel; may be overwritten."""
        ...


@dataclass(frozen=True, eq=False)
class Channel:
    """Light of one color: ``light`` and ``ahead`` in the memory of its state."""

    state: OptimizerState
    taps: Taps
    length: float = 1.0

    @property
    def light(self) -> DeviceArray:
        return self.state.buffer("light")

    @property
    def ahead(self) -> DeviceArray:
        return self.state.buffer("ahead")

    def gain(self, rounds: int) -> float:
        """Greatest eigenvalue of projecting, filtering and exposing, by power iteration; not counted as evaluations."""
        state, value = self.state, 1.0
        x = state.device.upload(np.random.default_rng(1).random(state.operator.domain.shape, np.float32))
        projected, filtered = state.sinogram(), state.sinogram()
        for _ in range(rounds):
            state.scale(1.0 / dot(x, x) ** 0.5, x, x)
            state.operator(x, out=projected)
            state.filter(projected, self.taps, filtered)
            state.operator.T(filtered, out=x)
            value = dot(x, x) ** 0.5
        return value


@dataclass(frozen=True)
class StepRule:
    """Length of steps, and what happens if the loss does not fall."""

    step: float | None = None  # length of the first step; None for one that changes the light by ``share`` of itself
    share: float = 0.1
    growth: float = 1.0  # factor of the step after one that lowered the loss
    momentum: float | None = None  # share of the last step added to the next; None for Nesterov's k / (k + 3)
    shrink: float = 0.5  # factor of the step if the loss rises within ``soon`` steps of a restart
    soon: float = inf  # a later rise only resets the momentum
    calm: float = 1.0  # share of the growth that remains after a rise
    back: float = inf  # steps are undone if the loss exceeds this multiple of the least loss; 1 undoes every rise
    possible: bool = False  # whether ``ahead`` is kept ≥ 0, where doses do not add up linearly
    fixed: bool = False  # ignore the loss: the result at a position then depends only on its neighborhood
    history: int = 0  # pairs of a limited-memory quasi-Newton method; 0 for steps along the filtered gradient
    history_bytes: int | None = None  # memory that they may use; None for the device's free memory


def minimize(objective: Objective, channels: Sequence[Channel], rule: StepRule) -> Steps:
    """Minimize over light ≥ 0 from ``light`` in the channels' memories, by which a later call goes on bit for bit."""
    if rule.history:
        yield from _searched(objective, channels[0].state, rule)
        return
    lead = channels[0].state
    memory, best = lead.memory, lead.best
    for channel in channels:
        if "ahead" not in channel.state.memory:
            channel.state.memory["ahead"] = channel.state.sinogram()
            combine(1.0, channel.light, 0.0, channel.light, channel.ahead)
    if rule.step is not None:
        memory.setdefault("step", rule.step)
    while True:
        loss, window = objective.value(lead.number("carried"))
        returned = memory.pop("returned", False)  # returned to the best light, whose loss is not progress yet
        rose = not (rule.fixed or returned or loss < lead.number("loss", inf))
        if not rule.fixed and _offered(channels, loss, window, rule.possible):
            memory["retreats"] = 0.0
        _lengthened(lead, rule, rose, returned)
        memory["loss"] = loss
        if rose and rule.back < inf and not loss < rule.back * best.loss:
            loss, window = _retreated(channels, loss, window)
        elif loss > 0.0 or rule.fixed:
            _moved(objective, channels, rule)
        yield loss, window
        if not rule.fixed and (loss == 0.0 or lead.number("retreats") >= RETREATS):
            return


def _offered(channels: Sequence[Channel], loss: float, window: float, possible: bool) -> bool:
    """Whether the evaluated light is the best so far; if it is, a copy is stored."""
    iteration = channels[0].state.iteration + possible
    offers = [
        channel.state.best.offer(channel.ahead if possible else channel.light, loss, window, iteration)
        for channel in channels
    ]
    return offers[0]


def _lengthened(lead: OptimizerState, rule: StepRule, rose: bool, returned: bool) -> None:
    """Lengthen the step, or shorten it and reset the momentum."""
    memory, growth = lead.memory, lead.number("growth", rule.growth)
    if rose:
        memory["step"] = lead.number("step") * (rule.shrink if lead.number("run") <= rule.soon else 1.0)
        memory["growth"] = 1.0 + rule.calm * (growth - 1.0)
        memory["run"] = 0.0
    elif "step" in memory and not returned:
        memory["step"] = lead.number("step") * growth


def _retreated(channels: Sequence[Channel], loss: float, window: float) -> tuple[float, float]:
    """Return to the best light, if there is one; returns its loss and window."""
    lead = channels[0].state
    for channel in channels:
        if "best" in channel.state.memory:
            for light in (channel.light, channel.ahead):
                channel.state.scale(1.0, channel.state.buffer("best"), light)
            loss, window = lead.best.loss, lead.best.window
    lead.memory.update({"loss": loss, "carried": 0.0, "returned": True, "retreats": lead.number("retreats") + 1.0})
    lead.best.unseen = None
    return loss, window


def _moved(objective: Objective, channels: Sequence[Channel], rule: StepRule) -> None:
    """One step of every channel; pixels that are dark and should stay dark are held."""
    lead, gradients = channels[0].state, objective.gradient()
    run = lead.number("run")
    momentum = run / (run + 3.0) if rule.momentum is None else rule.momentum * (run > 0 or rule.fixed)
    for channel, gradient in zip(channels, gradients, strict=True):
        channel.state.apply_penalty(channel.ahead, gradient)
        if "step" not in lead.memory:
            lead.memory["step"] = rule.share * _ratio(channel.light, gradient)
        channel.state.step(gradient, channel.taps, lead.number("step") * channel.length, momentum)
        if rule.possible:
            combine(1.0, channel.ahead, 0.0, channel.ahead, channel.ahead, floor=0.0)
    lead.memory.update({"run": run + 1.0, "carried": 0.0 if rule.possible else momentum})
    lead.best.unseen = objective.loss


def _ratio(light: DeviceArray, gradient: DeviceArray) -> float:
    """Norm of the light divided by that of the gradient."""
    own, other = dots((light, light), (gradient, gradient))
    return (own / max(other, 1e-60)) ** 0.5


def _searched(objective: Objective, state: OptimizerState, rule: StepRule) -> Steps:
    """Projected steps along limited-memory directions, each shortened until the loss falls."""
    memory = state.memory
    if "loss" not in memory:
        memory["loss"], memory["window"] = objective.value()
        objective.gradient()
    pairs = Pairs(state, rule.history, rule.history_bytes)
    direction = state.sinogram()
    while True:
        pairs.direct(direction)
        pairs.open()
        if not _line(objective, state, pairs, direction):
            memory["stuck"] = float(not pairs.used and state.affords(1.0))
            pairs.forget()
        yield state.number("loss"), state.number("window")
        if state.number("stuck"):
            return


def _line(objective: Objective, state: OptimizerState, pairs: Pairs, direction: DeviceArray) -> bool:
    """Move light along a direction, shortened until the loss falls; else leave light and gradient unchanged."""
    light, gradient, before = state.buffer("light"), state.buffer("gradient"), state.number("loss")
    share = 1.0 if pairs.used else 0.05 * _ratio(light, direction)
    state.scale(1.0, light, pairs.step)
    state.scale(1.0, gradient, pairs.change)
    for _ in range(TRIES):
        if not state.affords(1.0):
            break
        combine(1.0, pairs.step, share, direction, light, floor=0.0)
        if state.most < inf:
            capped(light, state.most)
        if state.lit is not None:
            state.device.launch(multiply, x=light, y=state.lit, out=light)
        loss, window = objective.value()
        if loss < before:
            objective.gradient()
            state.memory.update({"loss": loss, "window": window})
            pairs.close(light, gradient)
            return True
        share *= 0.4
    state.scale(1.0, pairs.step, light)
    state.scale(1.0, pairs.change, gradient)
    return False

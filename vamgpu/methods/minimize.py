"""One way down for every loss: steps that keep light ≥ 0, with momentum, restarts and a memory to go on from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf
from typing import Protocol

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.losses.loss import Loss
from vamgpu.methods.method import Steps
from vamgpu.methods.pairs import Pairs
from vamgpu.methods.ramp import Taps
from vamgpu.methods.state import OptimizerState
from vamgpu.operators.compose import combine
from vamgpu.operators.reductions import dot

RETREATS = 24
"""Returns to the best light in a row, each with steps half as long, after which none that helps is expected."""
TRIES = 12
"""Lengths that a line search looks at."""


class Objective(Protocol):
    """What light is judged by, above all the loss of its dose."""

    loss: Loss

    def value(self, carried: float = 0.0) -> tuple[float, float]:
        """Loss and strict window of the light held, or of the light ``ahead`` of it by ``carried`` of the last step."""
        ...

    def gradient(self) -> Sequence[DeviceArray]:
        """Derivatives of the loss last valued by the light of each channel, ahead as it was; may be overwritten."""
        ...


@dataclass(frozen=True, eq=False)
class Channel:
    """Light of one color: ``light`` and ``ahead`` of it in the memory of its state.

    Attributes:
        state: Its operator and memory.
        taps: Filter of its gradient along r.
        length: Of its steps over those of the others.
    """

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
        """Greatest eigenvalue of exposing what is filtered and projected, by power iteration; not counted."""
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
class Pace:
    """How long steps are, and what happens where the loss does not fall.

    Attributes:
        step: Length of the first; None takes one that changes the light by ``share`` of itself.
        share: See ``step``.
        growth: Of the step, after one that lowered the loss.
        momentum: Share of the last step that is added to the next; None for Nesterov's k / (k + 3). A rise drops it.
        shrink: Of the step where the loss rises ...
        soon: ... within so many steps of a restart; a later rise costs the momentum alone.
        calm: Share of the growth that a rise leaves.
        back: Times the least loss, from which on the light is again the best so far. 1 takes back every step that does
            not lower the loss, which then never rises from one record to the next.
        possible: Whether what momentum carries ahead is kept ≥ 0, so that it can be shown and returned; needed where
            doses do not add up linearly.
        fixed: No regard for the loss, and no best light: what happens at a place depends on what is near it alone.
        history: Pairs of a limited-memory quasi-Newton method, whose steps are searched for along its directions; 0
            for steps along the filtered gradient.
        history_bytes: Memory they may take; None for what the device has.
    """

    step: float | None = None
    share: float = 0.1
    growth: float = 1.0
    momentum: float | None = None
    shrink: float = 0.5
    soon: float = inf
    calm: float = 1.0
    back: float = inf
    possible: bool = False
    fixed: bool = False
    history: int = 0
    history_bytes: int | None = None


def minimize(objective: Objective, channels: Sequence[Channel], pace: Pace) -> Steps:
    """Lower an objective by light ≥ 0, from ``light`` in the memory of each channel on.

    It goes on for ever, or until the loss is 0 or no step lowers it; whoever asks for its records counts, cancels and
    tells divergence. Numbers are kept in the memory of the first channel. A later call with the same memories goes on
    bit by bit where this one stopped. The best light is kept as the criterion of the works says.

    Yields:
        Loss and strict window: of the light held where steps are taken back; else of the point ahead of it, and the
        window of the light that was held before the step.
    """
    if pace.history:
        yield from _searched(objective, channels[0].state, pace)
        return
    lead = channels[0].state
    memory, best = lead.memory, lead.best
    for channel in channels:
        if "ahead" not in channel.state.memory:
            channel.state.memory["ahead"] = channel.state.sinogram()
            combine(1.0, channel.light, 0.0, channel.light, channel.ahead)
    if pace.step is not None:
        memory.setdefault("step", pace.step)
    while True:
        loss, window = objective.value(lead.number("carried"))
        returned = memory.pop("returned", False)  # to the best light, whose loss is no progress yet
        rose = not (pace.fixed or returned or loss < lead.number("loss", inf))
        if not pace.fixed and _offered(channels, loss, window, pace.possible):
            memory["retreats"] = 0.0
        _paced(lead, pace, rose, returned)
        memory["loss"] = loss
        if rose and pace.back < inf and not loss < pace.back * best.loss:
            loss, window = _retreated(channels, loss, window)
        elif loss > 0.0 or pace.fixed:
            _moved(objective, channels, pace)
        yield loss, window
        if not pace.fixed and (loss == 0.0 or lead.number("retreats") >= RETREATS):
            return


def _offered(channels: Sequence[Channel], loss: float, window: float, possible: bool) -> bool:
    """Whether the light looked at is the best so far; a copy of it is kept then."""
    iteration = channels[0].state.iteration + possible
    offers = [
        channel.state.best.offer(channel.ahead if possible else channel.light, loss, window, iteration)
        for channel in channels
    ]
    return offers[0]


def _paced(lead: OptimizerState, pace: Pace, rose: bool, returned: bool) -> None:
    """Lengthen the step, or shorten it and drop the momentum."""
    memory, growth = lead.memory, lead.number("growth", pace.growth)
    if rose:
        memory["step"] = lead.number("step") * (pace.shrink if lead.number("run") <= pace.soon else 1.0)
        memory["growth"] = 1.0 + pace.calm * (growth - 1.0)
        memory["run"] = 0.0
    elif "step" in memory and not returned:
        memory["step"] = lead.number("step") * growth


def _retreated(channels: Sequence[Channel], loss: float, window: float) -> tuple[float, float]:
    """Go back to the best light, if there is one yet; returns its loss and window."""
    lead = channels[0].state
    for channel in channels:
        if "best" in channel.state.memory:
            for light in (channel.light, channel.ahead):
                channel.state.scale(1.0, channel.state.buffer("best"), light)
            loss, window = lead.best.loss, lead.best.window
    lead.memory.update({"loss": loss, "carried": 0.0, "returned": True, "retreats": lead.number("retreats") + 1.0})
    lead.best.unseen = None
    return loss, window


def _moved(objective: Objective, channels: Sequence[Channel], pace: Pace) -> None:
    """One step of every channel; what is dark and should stay so is held."""
    lead, gradients = channels[0].state, objective.gradient()
    run = lead.number("run")
    momentum = run / (run + 3.0) if pace.momentum is None else pace.momentum * (run > 0 or pace.fixed)
    for channel, gradient in zip(channels, gradients, strict=True):
        channel.state.apply_penalty(channel.ahead, gradient)
        if "step" not in lead.memory:
            lead.memory["step"] = pace.share * _ratio(channel.light, gradient)
        channel.state.step(gradient, channel.taps, lead.number("step") * channel.length, momentum)
        if pace.possible:
            combine(1.0, channel.ahead, 0.0, channel.ahead, channel.ahead, floor=0.0)
    lead.memory.update({"run": run + 1.0, "carried": 0.0 if pace.possible else momentum})
    lead.best.unseen = objective.loss


def _ratio(light: DeviceArray, gradient: DeviceArray) -> float:
    """Length of the light over that of the gradient."""
    return (dot(light, light) / max(dot(gradient, gradient), 1e-60)) ** 0.5


# ---- along quasi-Newton directions -------------------------------------------------------------------------------
def _searched(objective: Objective, state: OptimizerState, pace: Pace) -> Steps:
    """Projected steps along limited-memory directions, each shorter until the loss falls."""
    memory = state.memory
    if "loss" not in memory:
        memory["loss"], memory["window"] = objective.value()
        objective.gradient()
    pairs = Pairs(state, pace.history, pace.history_bytes)
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
    """Move light along a direction, shorter until the loss falls; else leave light and gradient as they were."""
    light, gradient, before = state.buffer("light"), state.buffer("gradient"), state.number("loss")
    share = 1.0 if pairs.used else 0.05 * _ratio(light, direction)
    state.scale(1.0, light, pairs.step)
    state.scale(1.0, gradient, pairs.change)
    for _ in range(TRIES):
        if not state.affords(1.0):
            break
        state.combine(1.0, pairs.step, share, direction, light, floor=0.0)
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

"""Accelerated, preconditioned descent of the light of both colors at once."""

from __future__ import annotations

from collections.abc import Iterator
from math import sqrt

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.operators.projection import Projection
from vamgpu.operators.reductions import dot
from vamgpu.optimize.band import Band
from vamgpu.optimize.joint.models import Model, Pair
from vamgpu.optimize.ramp import capped_ramp
from vamgpu.optimize.work import Work

CAP, SPAN = 0.25, 0.25
"""Of the ramp: frequency [cycles a column] beyond which it is level, and share of the columns it reaches over."""
ROUNDS = 6
"""Power iterations for the length of a step."""
SHORTEST = 2.0**-12


class Color:
    """Light of one color, the point ahead of it, and how far a step goes."""

    def __init__(self, operator: Projection, target: DeviceArray, light: DeviceArray) -> None:
        ahead = operator.device.empty(light.shape)
        self.work = Work(operator, target, {"light": light, "ahead": ahead})
        self.work.scale(1.0, light, ahead)
        self.taps = capped_ramp(operator, CAP, SPAN)

    @property
    def light(self) -> DeviceArray:
        return self.work.held("light")

    @property
    def ahead(self) -> DeviceArray:
        return self.work.held("ahead")

    def gain(self) -> float:
        """Greatest eigenvalue of exposing what is filtered and projected, by power iteration."""
        work, rng = self.work, np.random.default_rng(1)
        x = work.device.upload(rng.random(work.operator.domain.shape, np.float32))
        shadow, filtered, value = work.sinogram(), work.sinogram(), 1.0
        for _ in range(ROUNDS):
            work.scale(1.0 / sqrt(dot(x, x)), x, x)
            work.operator(x, out=shadow)
            work.filter(shadow, self.taps, filtered)
            work.operator.T(filtered, out=x)
            value = sqrt(dot(x, x))
        return value


class Descent:
    """Steps through capped ramps that keep light ≥ 0; momentum restarts and steps halve where the loss rises.

    A step is as long as the linear model stands: what is not linear in the kinetics flattens, and rarely steepens, it.
    """

    def __init__(self, model: Model, target: DeviceArray, band: Band, light: Pair, share: float) -> None:
        self.model, self.band = model, band
        self.colors = tuple(Color(A, target, part) for A, part in zip(model.operators, light, strict=True))
        resin, turns = model.resin, model.turns
        answers = (turns * resin.visible, turns * abs(resin.subtraction))
        self.lengths = [
            portion / (color.gain() * max(answer, 1e-30) ** 2)
            for color, answer, portion in zip(self.colors, answers, (1.0 - share, share), strict=True)
        ]
        self.run, self.length = 0, 1.0

    @property
    def light(self) -> Pair:
        """The light found so far."""
        return Pair(*(color.light for color in self.colors))

    def steps(self) -> Iterator[tuple[float, float]]:
        """Loss and strict window of the effective dose that each step looked at."""
        before, work = float("inf"), self.colors[0].work
        while self.length >= SHORTEST:
            dose = self.model.expose(Pair(*(color.ahead for color in self.colors)))
            window, _ = work.window(dose)
            loss = work.loss(dose, self.band)
            if loss > before:
                self.length *= 0.5 if self.run <= 1 else 1.0
                self.run = 0
            before = loss
            if loss > 0.0:
                self._move(self.model.gradient(dose))
            yield loss, window
            if loss == 0.0:
                return

    def _move(self, gradient: Pair) -> None:
        momentum = self.run / (self.run + 3.0)
        for color, slope, length in zip(self.colors, gradient, self.lengths, strict=True):
            color.work.free(color.ahead, slope)
            color.work.step(slope, color.taps, self.length * length, momentum)
        self.run += 1

"""Accelerated, preconditioned descent of the light of both colors at once."""

from __future__ import annotations

from collections.abc import Iterator
from math import sqrt

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.methods.band import Band
from vamgpu.methods.joint.models import Model, Pair
from vamgpu.methods.ramp import capped_ramp
from vamgpu.methods.work import Work
from vamgpu.operators.projection import Projection
from vamgpu.operators.reductions import dot

CAP, SPAN = 0.25, 0.25
"""Of the ramp: frequency [cycles a column] beyond which it is level, and share of the columns it reaches over."""
ROUNDS = 6
"""Power iterations for the length of a step."""
SHORTEST = 2.0**-12
GROWTH, SHRINK = 1.04, 0.6
"""Of a step while the loss falls, for what decays and depletes answers more weakly than the first light promises; and
where it rises, after which steps also grow half as fast."""
BLOWN = 1.5
"""Of the least loss: from there the descent begins again at the light that had it."""


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
    """Steps through capped ramps that keep light ≥ 0; where the loss rises momentum restarts and steps are shorter.

    The first step is as long as the linear model stands, and later ones grow. The point that momentum carries ahead is
    cut off at darkness too, so that every dose looked at is that of possible light, and the best of it can be returned.
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
        self.best = Pair(*(color.work.sinogram() for color in self.colors))
        self.run, self.length, self.growth = 0, 1.0, GROWTH
        self.looked = self.best_iteration = 0

    @property
    def light(self) -> Pair:
        """The light of least loss among those looked at; the first one before any was."""
        return self.best if self.best_iteration else Pair(*(color.light for color in self.colors))

    def steps(self) -> Iterator[tuple[float, float]]:
        """Loss and strict window of the effective dose that each step looked at."""
        before = least = float("inf")
        work = self.colors[0].work
        while self.length >= SHORTEST:
            dose = self.model.expose(Pair(*(color.ahead for color in self.colors)))
            window, _ = work.window(dose)
            loss = work.loss(dose, self.band)
            self._pace(loss > before)
            self.looked += 1
            if loss <= least:
                least, self.best_iteration = loss, self.looked
                self._copy([(color.ahead, best) for color, best in zip(self.colors, self.best, strict=True)])
            before = loss
            if loss > BLOWN * least:
                before = least
                both = zip(self.colors, self.best, strict=True)
                self._copy([(best, own) for color, best in both for own in (color.light, color.ahead)])
            elif loss > 0.0:
                self._move(self.model.gradient(dose))
            yield loss, window
            if loss == 0.0:
                return

    def _pace(self, rose: bool) -> None:
        """How far to go, and with how much momentum."""
        self.run = 0 if rose else self.run
        self.growth = 1.0 + 0.5 * (self.growth - 1.0) if rose else self.growth
        self.length *= SHRINK if rose else self.growth

    def _copy(self, pairs: list[tuple[DeviceArray, DeviceArray]]) -> None:
        """Light, which is not negative, from the first of each pair to the second."""
        for source, target in pairs:
            self.colors[0].work.combine(1.0, source, 0.0, source, target, floor=0.0)

    def _move(self, gradient: Pair) -> None:
        momentum = self.run / (self.run + 3.0)
        for color, slope, length in zip(self.colors, gradient, self.lengths, strict=True):
            color.work.free(color.ahead, slope)
            color.work.step(slope, color.taps, self.length * length, momentum)
            color.work.combine(1.0, color.ahead, 0.0, color.ahead, color.ahead, floor=0.0)
        self.run += 1

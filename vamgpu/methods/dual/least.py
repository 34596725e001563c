"""Two sinograms that are never negative, in the sense of least squares; for volumes of any size."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from math import inf, sqrt
from typing import Any, ClassVar

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.chemistry.species import PAPER
from vamgpu.errors import BadInput
from vamgpu.methods.band import Band
from vamgpu.methods.dual.colors import Pass, combine, constant
from vamgpu.methods.dual.passes import Bench
from vamgpu.methods.papers import NESTEROV, RAMP, RESTART, TWO_METRIC
from vamgpu.methods.ramp import Taps, capped_ramp, identity
from vamgpu.methods.work import Work
from vamgpu.operators.linear import LinearOperator
from vamgpu.operators.projection import Projection
from vamgpu.operators.reductions import EVERYWHERE, dot

SPAN = 0.25
"""Share of the columns that the preconditioner reaches over."""
_ROUNDS = 8
"""Power iterations for the length of a step."""
_SOON = 3
"""Steps after a restart within which a rise means that steps are too long, not that momentum overshot."""


@dataclass(frozen=True)
class LeastSquares:
    """Least ½‖visible dose − strength·UV dose − design‖² over light ≥ 0, by accelerated projected gradients.

    Each color has its own operator and its exact transpose; a capped ramp along r preconditions both, as in
    `ProcessWindow`, where the operator is a `Projection`. An iteration is two projector pairs.

    iterations: in all.  below: dose by which a voxel out of the part may fall under zero at no cost (an inhibited void
    need not be exactly at zero).  cost: of light, per unit, added to the loss for both colors: keeps the same light
    from being sent twice with opposite effect.  cap: frequency [cycles per column] beyond which the ramp is level.
    Raises `BadInput`.
    """

    iterations: int = 60
    below: float = 0.0
    cost: float = 0.0
    cap: float = 0.25
    papers: ClassVar[tuple[str, ...]] = (PAPER, NESTEROV, RESTART, RAMP, TWO_METRIC)

    def __post_init__(self) -> None:
        if self.iterations < 1 or not self.below >= 0 or not self.cost >= 0 or not 0 < self.cap <= 0.5:
            raise BadInput(f"{self!r}: wanted iterations ≥ 1, below ≥ 0, cost ≥ 0 and 0 < cap ≤ 0.5")

    def steps(self, bench: Bench) -> Iterator[Pass]:
        """One iteration after another; the records are of the light each looked at, the bench holds the best of it."""
        visible, uv = _Color(bench, bench.colors.visible, self.cap, 1.0), _Color(
            bench, bench.colors.uv, self.cap, -bench.colors.strength)  # fmt: skip
        bench.light, bench.uv = visible.best, uv.best
        least = inf
        # half of what the gains allow: gradients held at dark light have gaps, which the ramp turns into coarse light
        pace = _Pace(0.5 / (visible.gain() + uv.gain()))
        band = Band((-0.5 * self.below, 1.0), (0.5 * self.below, 0.0), (0.5, 0.5))
        dose, under, over = bench.volume(), bench.volume(), bench.volume()
        for _ in range(self.iterations):
            visible.expose(dose)
            uv.expose(under)
            combine(1.0, dose, -bench.colors.strength, under, dose)
            record = bench.compare(dose, bench.design, under, over)
            loss = visible.work.loss(dose, band)
            for color in (visible, uv):
                loss += color.pull(dose, self.cost)
            if loss < least:
                least = loss
                for color in (visible, uv):
                    color.keep()
            pace.look(loss)
            for color in (visible, uv):
                color.move(pace.step, pace.momentum)
            pace.run += 1
            yield record


class _Color:
    """Light of one color, the point ahead of it and the gradient there."""

    def __init__(self, bench: Bench, operator: LinearOperator, cap: float, sign: float) -> None:
        self.bench, self.operator, self.sign = bench, operator, sign
        light, ahead, self.best = (constant(0.0, operator.range.shape, bench.design) for _ in range(3))
        self.gradient = bench.sinogram()
        projector: Any = operator
        self.work = Work(projector, bench.design, {"light": light, "ahead": ahead})
        if bench.colors.whole:
            self.work.reach = EVERYWHERE
        plain = not isinstance(operator, Projection)
        self.taps: Taps = identity(projector) if plain else capped_ramp(projector, cap, SPAN)

    def expose(self, dose: DeviceArray) -> None:
        self.bench.expose(self.operator, self.work.held("ahead"), dose)

    def pull(self, slope: DeviceArray, cost: float) -> float:
        """gradient = that of the loss by the light ahead, dark light held; returns what the light costs."""
        self.operator(slope, out=self.gradient)
        self.bench.pairs += 0.5
        combine(self.sign, self.gradient, 0.0, self.gradient, self.gradient)
        return self.work.free(self.work.held("ahead"), self.gradient, cost)

    def keep(self) -> None:
        """Best light = the one looked at."""
        combine(1.0, self.work.held("ahead"), 0.0, self.best, self.best)

    def move(self, step: float, momentum: float) -> None:
        """Move the light; what momentum carries ahead of it is never negative either, so that it can be kept."""
        self.work.step(self.gradient, self.taps, step, momentum)
        ahead = self.work.held("ahead")
        combine(1.0, ahead, 0.0, ahead, ahead, 0.0)

    def gain(self) -> float:
        """Greatest eigenvalue of exposing what is filtered and projected, by power iteration."""
        rng = np.random.default_rng(1)
        x = self.bench.device.upload(rng.random(self.operator.domain.shape, np.float32))
        value, filtered = 1.0, self.bench.sinogram()
        for _ in range(_ROUNDS):
            combine(1.0 / sqrt(dot(x, x)), x, 0.0, x, x)
            self.operator(x, out=self.gradient)
            self.work.filter(self.gradient, self.taps, filtered)
            self.bench.expose(self.operator, filtered, x)
            self.bench.pairs += 0.5
            value = sqrt(dot(x, x))
        return value * self.sign**2


@dataclass
class _Pace:
    """Length of a step and momentum: restarts when the loss rises, and halves the step when it rises again soon."""

    step: float
    run: float = 0.0
    loss: float = field(default=float("inf"))

    @property
    def momentum(self) -> float:
        return self.run / (self.run + 3.0)

    def look(self, loss: float) -> None:
        if loss > self.loss:
            self.step *= 0.5 if self.run <= _SOON else 1.0
            self.run = 0.0
        self.loss = loss


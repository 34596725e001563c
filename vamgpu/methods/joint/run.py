"""`optimize_colors`: light of both colors for a part, through the kinetics of photoinhibition."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.chemistry.species import PAPER
from vamgpu.errors import BadInput, Cancelled
from vamgpu.losses.band import Band
from vamgpu.methods.joint.contrast import EffectiveContrast
from vamgpu.methods.joint.descent import ColorDescent
from vamgpu.methods.joint.models import LinearModel, Model, Pair
from vamgpu.methods.joint.resin import TwoColorResin
from vamgpu.methods.papers import NESTEROV, RAMP, RESTART, TWO_METRIC
from vamgpu.methods.part import fractions_of
from vamgpu.methods.plan import Step
from vamgpu.methods.run import optimize
from vamgpu.operators.compose import combine
from vamgpu.operators.space import require

LINEAR = 4
"""Iterations of the linear model for each that visible light alone gets: they cost next to nothing."""


@dataclass(frozen=True)
class Aims:
    """Effective doses that are asked for, where 1 is the end of the induction, T_opt.

    outside: at most, out of the part.  inside, most: in the part; inside is T_mec/T_opt or more.  share: of a step
    that ultraviolet takes over, 0 … 1.  Raises `BadInput` unless 0 < outside < 1 < inside ≤ most.
    """

    outside: float = 0.85
    inside: float = 1.25
    most: float = 1.5
    share: float = 0.5
    iterations: ClassVar[int] = 40

    def __post_init__(self) -> None:
        if not 0.0 < self.outside < 1.0 < self.inside <= self.most < float("inf") or not 0.0 <= self.share <= 1.0:
            raise BadInput(f"{self!r}: wanted 0 < outside < 1 < inside ≤ most and a share of 0 to 1")

    def band(self, resin: TwoColorResin) -> Band:
        """Out of the part less is never wrong, however far below 0 B takes it."""
        depth = 0.5 * (self.outside - min(resin.lowest, 0.0)) + 1.0
        middle, half = 0.5 * (self.inside + self.most), 0.5 * (self.most - self.inside)
        return Band((self.outside - depth, middle), (depth, half), (0.5, 0.5), 2.0, binary=True)


@dataclass(frozen=True, eq=False)
class ColorPlan:
    """Light of both colors for one turn, repeated ``model.turns`` times: that of least loss, not the last.

    visible, ultraviolet: [angle, r, z] ≥ 0 on the device.  model, aims: what made it.  history: one `Step` an
    iteration; a pair is one forward and one back projection of both colors.  seconds: of the run.  best_iteration: that
    which looked at this light, counted from 1; 0 where none looked at any.
    """

    visible: DeviceArray
    ultraviolet: DeviceArray
    model: Model
    aims: Aims
    target: DeviceArray
    history: tuple[Step, ...]
    papers: tuple[str, ...]
    seconds: float
    best_iteration: int = 0

    @property
    def light(self) -> Pair:
        return Pair(self.visible, self.ultraviolet)

    def effective_dose(self, model: Model | None = None) -> DeviceArray:
        """Effective dose [x, y, z] after the last turn; another model judges the same light."""
        return (model or self.model).expose(self.light)

    def linear_dose(self) -> DeviceArray:
        """What the linear model visible − k·ultraviolet makes of the light, to be reported beside."""
        model = self.model
        return LinearModel(*model.operators, model.resin, model.turns).expose(self.light)

    def contrast(self, model: Model | None = None) -> EffectiveContrast:
        """Of the effective dose; another model judges the same light."""
        reach = self.model.operators[0].grid.cylinder()
        return EffectiveContrast.of(self.effective_dose(model), self.target, reach[:, :, None])


def optimize_colors(
    model: Model, target: Any, aims: Aims = Aims(), iterations: int | None = None, *,
    start: Pair | ColorPlan | None = None, warm: int = 10, progress: Callable[[Step], None] | None = None,
) -> ColorPlan:  # fmt: skip
    """Light of both colors, never negative, whose effective dose prints the target.

    model: `KineticModel`, or `LinearModel` to compare with.  target: a `Target`, or fractions [x, y, z].  start: light
    to begin with, copied; by default what the linear model finds in 4·``warm`` iterations, from the visible light of
    ``warm`` iterations for that color alone.
    progress: gets every `Step`.  Raises `BadInput`, `ShapeMismatch`; `Cancelled` with the plan so far on Ctrl-C.
    """
    begun, count = time.perf_counter(), _whole("iterations", Aims.iterations if iterations is None else iterations)
    fractions = fractions_of(model.operators[0], target)
    light = _warm(model, fractions, aims, _whole("warm", warm)) if start is None else _copied(model, start)
    descent, history = ColorDescent(model, fractions, aims.band(model.resin), light, aims.share), []

    def plan() -> ColorPlan:
        papers = (PAPER, NESTEROV, RESTART, RAMP, TWO_METRIC)
        seconds = time.perf_counter() - begun
        found = descent.light
        return ColorPlan(
            *found, model, aims, fractions, tuple(history), papers, seconds, descent.best_iteration)  # fmt: skip

    try:
        for number, record in zip(range(1, count + 1), descent.steps()):  # noqa: B905 - whichever ends first
            history.append(Step(number, float(number), *record))
            if progress:
                progress(history[-1])
    except KeyboardInterrupt:
        raise Cancelled(f"interrupted after {len(history)} iterations; pass the error's plan as start= to go on",
                        plan()) from None  # type: ignore[arg-type]  # fmt: skip
    return plan()


def _whole(name: str, value: Any) -> int:
    if isinstance(value, bool) or int(value) != value or value < 1:
        raise BadInput(f"{name} is {value!r}; wanted a whole number ≥ 1")
    return int(value)


def _warm(model: Model, target: DeviceArray, aims: Aims, iterations: int) -> Pair:
    """Visible light that brings the part to the middle of what is wanted, and what the linear model makes of it."""
    visible, ultraviolet = model.operators
    found = optimize(visible, target, iterations=iterations)
    device, light = visible.device, found.sinogram
    dose = found.dose().numpy()[target.numpy() >= 0.5]
    scale = 0.5 * (aims.inside + aims.most) / max(float(dose.mean()) * model.turns * model.resin.visible, 1e-30)
    combine(scale, light, 0.0, light, light)
    pair = Pair(light, device.upload(np.zeros(ultraviolet.range.shape, np.float32)))
    if isinstance(model, LinearModel):
        return pair
    line = LinearModel(visible, ultraviolet, model.resin, model.turns)
    descent = ColorDescent(line, target, aims.band(model.resin), pair, aims.share)
    for _ in zip(range(LINEAR * iterations), descent.steps()):  # noqa: B905 - whichever ends first
        pass
    return descent.light


def _copied(model: Model, start: Pair | ColorPlan) -> Pair:
    """The light to start from, checked, so that what was given stays as it is."""
    copies = []
    for A, light in zip(model.operators, start.light if isinstance(start, ColorPlan) else start, strict=True):
        require(A.range, light, "the light to start from")
        given = light if isinstance(light, DeviceArray) else A.device.upload(light)
        A.device.check_mine(given)
        copies.append(combine(1.0, given, 0.0, given, A.device.empty(A.range.shape), floor=0.0))
    return Pair(*copies)

"""`optimize_colors`: light of both colors for a part, through the kinetics of photoinhibition."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.chemistry.species import PAPER
from vamgpu.errors import BadInput, Cancelled, EmptyMesh
from vamgpu.geometry import counts
from vamgpu.losses.band import Band
from vamgpu.methods.dual.colors import Pair
from vamgpu.methods.joint.descent import ColorDescent
from vamgpu.methods.joint.models import LinearModel, Model
from vamgpu.methods.joint.resin import TwoColorResin
from vamgpu.methods.papers import NESTEROV, RAMP, RESTART, TWO_METRIC
from vamgpu.methods.part import fractions_of, one_limit
from vamgpu.methods.plan import Step, copied
from vamgpu.methods.run import optimize
from vamgpu.operators.compose import combine
from vamgpu.operators.space import require


@dataclass(frozen=True)
class EffectiveContrast:
    """Effective doses, 1 at the end of the induction, in the part (fraction ≥ ½) and out of it."""

    in_least: float
    in_most: float
    out_most: float
    in_low: float  # fifth percentile in the part
    out_high: float  # ninety-fifth percentile out of it
    uncured: float  # share of the part below 1
    overcured: float  # share of the rest at 1 or above

    @property
    def window(self) -> float:
        """(Least dose in the part − greatest out of it) / the greatest in the part."""
        return (self.in_least - self.out_most) / max(self.in_most, 1e-30)

    @property
    def bulk(self) -> float:
        """The same from the fifth and the ninety-fifth percentile."""
        return (self.in_low - self.out_high) / max(self.in_most, 1e-30)

    @classmethod
    def of(cls, dose: Any, target: Any, counted: np.ndarray | None = None) -> EffectiveContrast:
        """Compare a dose with a target's fractions [x, y, z] where ``counted``. Raises `EmptyMesh`."""
        got, fraction = (np.asarray(value, np.float64) for value in (dose, target))
        chosen = np.ones(got.shape, bool) if counted is None else np.broadcast_to(counted, got.shape)
        part, rest = got[chosen & (fraction >= 0.5)], got[chosen & (fraction < 0.5)]
        if not part.size or not rest.size:
            raise EmptyMesh("no voxel is in the part, or none is out of it; contrast needs both")
        numbers = (part.min(), part.max(), rest.max(), np.percentile(part, 5), np.percentile(rest, 95),
                   np.mean(part < 1.0), np.mean(rest >= 1.0))  # fmt: skip
        return cls(*map(float, numbers))


WARM = 10  # iterations with only visible light, from which the descent of both colors begins
LINEAR = 4  # iterations of the linear model for each iteration with only visible light; they take little time


@dataclass(frozen=True)
class LossWeights:
    """Required effective doses; 1 is the end of the induction, T_opt.

    Args:
        outside: Greatest effective dose out of the part.
        inside, most: Least and greatest effective dose in the part; inside is T_mec/T_opt or more.
        share: Share of a step that ultraviolet light takes over, 0 … 1.

    Raises:
        BadInput: The values are not 0 < outside < 1 < inside ≤ most.
    """

    outside: float = 0.85
    inside: float = 1.25
    most: float = 1.5
    share: float = 0.5
    iterations: ClassVar[int] = 40

    def __post_init__(self) -> None:
        if not 0.0 < self.outside < 1.0 < self.inside <= self.most < float("inf") or not 0.0 <= self.share <= 1.0:
            raise BadInput(f"{self!r}: expected 0 < outside < 1 < inside ≤ most and a share of 0 to 1")

    def band(self, resin: TwoColorResin) -> Band:
        """Make the loss of a voxel.

        Args:
            resin: The resin whose effective dose is judged.

        Returns:
            The loss. Outside the part a lower dose is never wrong, however far below 0 B takes it.
        """
        depth = 0.5 * (self.outside - min(resin.lowest, 0.0)) + 1.0
        middle, half = 0.5 * (self.inside + self.most), 0.5 * (self.most - self.inside)
        return Band((self.outside - depth, middle), (depth, half), (0.5, 0.5), 2.0, binary=True)


@dataclass(frozen=True, eq=False)
class ColorPlan:
    """Light of both colors for one turn, repeated ``model.turns`` times: the light with the least loss, not the last.

    Args:
        visible, ultraviolet: Light [angle, r, z] ≥ 0 on the device.
        model, weights: The model and the weights of the run.
        target: Fractions [x, y, z].
        history: One `Step` per iteration; an evaluation is one forward and one back projection of both colors.
        papers: Papers of the method.
        seconds: Wall time of the run [s].
        best_iteration: The iteration that evaluated this light, counted from 1; 0 before any.
        state: Memory for resuming, by color; a resumed run continues from its last light, not from the best.
    """

    visible: DeviceArray
    ultraviolet: DeviceArray
    model: Model
    weights: LossWeights
    target: DeviceArray
    history: tuple[Step, ...]
    papers: tuple[str, ...]
    seconds: float
    best_iteration: int = 0
    state: tuple[dict[str, Any], ...] = field(default=(), repr=False)

    @property
    def light(self) -> Pair:
        """Light of both colors."""
        return Pair(self.visible, self.ultraviolet)

    def effective_dose(self, model: Model | None = None) -> DeviceArray:
        """Compute the effective dose after the last turn.

        Args:
            model: Another model that evaluates the same light; by default the plan's.

        Returns:
            Effective dose [x, y, z].
        """
        return (model or self.model).expose(self.light)

    def contrast(self, model: Model | None = None) -> EffectiveContrast:
        """Contrast of the effective dose.

        Args:
            model: Another model that evaluates the same light; by default the plan's.

        Returns:
            The contrast.
        """
        reach = self.model.operators[0].grid.cylinder()
        return EffectiveContrast.of(self.effective_dose(model), self.target, reach[:, :, None])


def optimize_colors(
    model: Model, target: Any, weights: LossWeights = LossWeights(), iterations: int | None = None, *,
    start: Pair | ColorPlan | None = None, warm: int = WARM, progress: Callable[[Step], None] | None = None,
    cancel: Callable[[], bool] | None = None, resume: ColorPlan | None = None,
) -> ColorPlan:  # fmt: skip
    """Find light of both colors, never negative, whose effective dose prints the target.

    Args:
        model: `KineticModel`, or `LinearModel` to compare with.
        target: A `Target`, or fractions [x, y, z].
        weights: Required effective doses.
        iterations: Total number, including those of ``resume``.
        start: Initial light, copied; by default that of the linear model.
        warm: Iterations with only visible light; four times as many follow for both colors in the linear model.
        progress: Gets every `Step`.
        cancel: Called before each step; returns whether to stop.
        resume: A plan of the same model and weights to continue, bit for bit; the plan does not change.

    Returns:
        The plan with the light of least loss.

    Raises:
        BadInput: A value is out of its range.
        ShapeMismatch: Shapes do not fit.
        Cancelled: ``cancel`` returned true, or Ctrl-C; carries the plan so far.
    """
    begun = time.perf_counter()
    (count,) = counts("iterations", (LossWeights.iterations if iterations is None else iterations,), 1)
    fractions = fractions_of(model.operators[0], one_limit(target))
    if resume is not None:
        memories, history = _resumed(model, weights, start, resume), list(resume.history)
        begun -= resume.seconds
    else:
        light = warm_light(model, fractions, weights, warm) if start is None else _copied(model, start)
        memories, history = tuple({"light": part} for part in light), []
    descent = ColorDescent(model, fractions, weights.band(model.resin), memories, weights.share)
    descent.state.iteration = len(history)

    def plan() -> ColorPlan:
        papers = (PAPER, NESTEROV, RESTART, RAMP, TWO_METRIC)
        seconds = time.perf_counter() - begun
        found = descent.light
        return ColorPlan(
            *found, model, weights, fractions, tuple(history), papers, seconds, descent.state.best.iteration,
            tuple(dict(memory) for memory in memories),
        )  # fmt: skip

    def cancelled(why: str) -> Cancelled:
        return Cancelled(f"{why} after {len(history)} iterations; pass the error's plan as resume= to continue", plan())

    steps = descent.steps()
    try:
        while len(history) < count:
            if cancel is not None and cancel():
                raise cancelled("cancelled by the caller")
            record = next(steps, None)
            if record is None:
                break
            history.append(Step(len(history) + 1, len(history) + 1.0, *record))
            if progress:
                progress(history[-1])
    except KeyboardInterrupt:
        raise cancelled("interrupted") from None
    return plan()


def _resumed(model: Model, weights: LossWeights, start: Any, plan: ColorPlan) -> tuple[dict[str, Any], ...]:
    """Copies of the memories of a plan. Raises `BadInput` if the plan is from another run."""
    if start is not None:
        raise BadInput("got both start and resume; expected one: start begins a new run, resume continues one")
    if plan.model is not model or plan.weights != weights or not plan.state:
        raise BadInput(f"the plan to resume is by {plan.model!r} for {plan.weights!r}; expected one of this same "
                       f"model, for {weights!r}: give start= for a new run from its light")  # fmt: skip
    return copied(plan.state)


def warm_light(model: Model, target: DeviceArray, weights: LossWeights, iterations: int) -> Pair:
    """Visible light that brings the part to the middle of its band, improved by the linear model in both colors."""
    (iterations,), (visible, ultraviolet) = counts("warm", (iterations,), 1), model.operators
    found = optimize(visible, target, iterations=iterations, progress=False)
    device, light = visible.device, found.sinogram
    dose = found.dose().numpy()[target.numpy() >= 0.5]
    scale = 0.5 * (weights.inside + weights.most) / max(float(dose.mean()) * model.turns * model.resin.visible, 1e-30)
    combine(scale, light, 0.0, light, light)
    pair = Pair(light, device.upload(np.zeros(ultraviolet.range.shape, np.float32)))
    if isinstance(model, LinearModel):
        return pair
    line = LinearModel(visible, ultraviolet, model.resin, model.turns)
    memories = tuple({"light": part} for part in pair)
    descent = ColorDescent(line, target, weights.band(model.resin), memories, weights.share)
    for _ in zip(range(LINEAR * iterations), descent.steps()):  # noqa: B905 - whichever ends first
        pass
    return descent.light


def _copied(model: Model, start: Pair | ColorPlan) -> Pair:
    """The initial light, checked and copied; the given light does not change."""
    copies = []
    for A, light in zip(model.operators, start.light if isinstance(start, ColorPlan) else start, strict=True):
        require(A.range, light, "the initial light")
        given = light if isinstance(light, DeviceArray) else A.device.upload(light)
        A.device.check_mine(given)
        copies.append(combine(1.0, given, 0.0, given, A.device.empty(A.range.shape), floor=0.0))
    return Pair(*copies)

"""The light of both colors for the turns that remain, through the kinetics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.geometry import positive
from vamgpu.live.fields import scaled
from vamgpu.live.replan import ROUNDING, SURE, Forecast, Replanned, allowed_turns, finite
from vamgpu.losses.band import Band
from vamgpu.losses.loss import Loss
from vamgpu.methods.joint.descent import ColorDescent, gains_of
from vamgpu.methods.joint.models import KineticModel, Pair, SpeciesFields
from vamgpu.methods.joint.run import LossWeights
from vamgpu.methods.part import fractions_of
from vamgpu.methods.state import OptimizerState
from vamgpu.metrics import score
from vamgpu.operators.compose import capped, combine
from vamgpu.operators.reductions import extent


@dataclass(frozen=True, eq=False)
class ColorReplanner:
    """Optimizes the light of both colors for the turns that remain; all of these turns show the same light.

    Doses of two colors do not add up: the delivered light is described by the state of the species in every voxel, from
    which the remaining kinetics start. Voxels that are certainly over their limit (void that is solid, part above its
    greatest dose) cannot be corrected and have no weight.

    Args:
        target: A `Target`, or fractions [x, y, z].
        model: Model of the planned print.
        most: Greatest light of a pixel of each color, in units of the plan's.
        weights: Required effective doses.
        threshold: Least effective dose of solid resin; None for the mean of outside and inside.

    Raises:
        BadInput: A value is out of its range.
    """

    target: Any
    model: KineticModel
    most: tuple[float, float]
    weights: LossWeights = field(default_factory=LossWeights)
    threshold: float | None = None

    def __post_init__(self) -> None:
        for color, most in zip(("visible", "ultraviolet"), self.most, strict=True):
            positive(f"greatest {color} light", most)

    @cached_property
    def _fractions(self) -> DeviceArray:
        return fractions_of(self.model.operators[0], self.target)

    @cached_property
    def _gains(self) -> tuple[float, ...]:
        return gains_of(self.model, self._fractions)

    def replan(
        self, model: KineticModel, delivered: SpeciesFields, plan: Pair, planned: int, turns: Sequence[int], *,
        evaluations: float, deviation: Any = 0.0,
    ) -> Replanned[Pair]:  # fmt: skip
        """The best light for the rest of a print with the given number of evaluations.

        Args:
            model: Model with operators and lamps as estimated, for example `KineticModel.going_on`; its turns and start
                have no effect.
            delivered: State after the turns so far, for example `KineticModel.state` of the light that was shown.
            plan: Planned light of each remaining turn, [angle, r, z] of both colors.
            planned: Planned number of remaining turns.
            turns: Allowed numbers of further turns, 0 for a stop now.
            evaluations: Limit of projector evaluations.
            deviation: Standard deviation of the effective dose so far, [x, y, z], or one for all.

        Returns:
            The best of the light found and the plan's own.

        Raises:
            BadInput: A state or light is not a number, or there are no turns.
            ShapeMismatch: An array has another geometry.
        """
        counts, allowed = allowed_turns(turns, planned), positive("evaluations", evaluations)
        state = SpeciesFields(*(finite(model.operators[0].domain, part, model.device, f"the {name}")
                                for name, part in zip(SpeciesFields._fields, delivered, strict=True)))  # fmt: skip
        light = Pair(*(finite(A.range, part, model.device, "the plan's light")
                       for A, part in zip(model.operators, plan, strict=True)))  # fmt: skip
        now = state.effective_dose(model.resin)
        judge = OptimizerState(model.operators[0], self._fractions, {}, "loss")
        loss = self._loss(model, now, deviation).on(judge.field)
        before = judge.part_mean(now)
        after = model.going_on(planned, state).expose(light) if planned else combine(1.0, now, 0.0, now, judge.volume())
        rise = max(judge.part_mean(after) - before, 0.0) if planned else 0.0
        spent = 0.5 * bool(planned)
        kept, kept_loss = self._judged(planned, after, judge, loss)
        shown = all(extent(part)[1] <= most * (1.0 + ROUNDING) for part, most in zip(light, self.most, strict=True))
        possible = (planned in counts and shown) or (counts[0] == 0 and not planned)
        best, best_loss = (light, kept), kept_loss if possible else np.inf
        if counts[0] == 0 and planned:
            forecast, stopped = self._judged(0, now, judge, loss)
            if stopped <= best_loss:
                best, best_loss = (Pair(*(scaled(part, 0.0) for part in light)), forecast), stopped
        if counts[-1] and rise:
            count, start = self._start(model, light, planned, counts, rise, before)
            lowered, steps = self._lowered(model.going_on(count, state), loss, start, allowed - spent - 0.5)
            spent += steps + 0.5
            forecast, found = self._judged(count, model.going_on(count, state).expose(lowered), judge, loss)
            if found < best_loss:
                best = (lowered, forecast)
        return Replanned(best[0], kept, best[1], spent)

    def _start(
        self, model: KineticModel, plan: Pair, planned: int, counts: Sequence[int], rise: float, before: float
    ) -> tuple[int, Pair]:
        """Turns, and the starting light: the plan's, scaled to give the part the middle of the required doses."""
        missing = max(0.5 * (self.weights.inside + self.weights.most) - before, 0.02)
        share = planned * missing / rise
        peak = share * max(extent(plan.visible)[1], 1e-30)
        count = next((n for n in counts if n and peak <= n * self.most[0] * (1.0 + ROUNDING)), counts[-1])
        weaker = self.model.resin.ultraviolet / model.resin.ultraviolet  # its light, relative to that found
        gains = (share / count, weaker * planned / count)
        return count, Pair(*(
            capped(combine(gain, part, 0.0, part, part.device.empty(part.shape)), most)
            for gain, part, most in zip(gains, plan, self.most, strict=True)
        ))  # fmt: skip

    def _lowered(self, model: KineticModel, loss: Band, start: Pair, allowed: float) -> tuple[Pair, int]:
        memories = tuple({"light": part} for part in start)
        descent = ColorDescent(model, self._fractions, loss, memories, self.weights.share, self._gains)
        spent, steps = 0, descent.steps()
        while spent + 1 <= allowed and next(steps, None) is not None:
            spent += 1
            for channel, most in zip(descent.channels, self.most, strict=True):
                capped(channel.light, most)
                capped(channel.ahead, most)
        return descent.light, spent

    def _loss(self, model: KineticModel, now: DeviceArray, deviation: Any) -> Band:
        """The loss of voxels that can still be corrected: solid ones stay solid, even with more inhibitor."""
        band = self.weights.band(model.resin)
        sure = np.asarray(now, float) - SURE * np.asarray(deviation, float)
        part = np.asarray(self._fractions) >= 0.5
        lost = np.where(part, sure > self.weights.most, sure >= self.weights.inside)
        return replace(band, weight=(~lost).astype(np.float32)) if lost.any() and not lost.all() else band

    def _judged(self, turns: int, dose: DeviceArray, judge: OptimizerState, loss: Loss) -> tuple[Forecast, float]:
        """The forecast of a print and its loss; the dose is overwritten by the loss's gradient."""
        return self._forecast(turns, dose, judge), judge.loss(dose, loss)

    def _forecast(self, turns: int, dose: DeviceArray, judge: OptimizerState) -> Forecast:
        threshold = 0.5 * (self.weights.outside + self.weights.inside) if self.threshold is None else self.threshold
        iou = float(score(dose, self._fractions, threshold=threshold).iou)
        return Forecast(turns, judge.window(dose)[0], iou, iou)

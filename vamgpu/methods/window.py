"""The default: a process window as wide as asked, by accelerated steps through a capped ramp."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.losses.band import MOST, Band
from vamgpu.losses.loss import Loss
from vamgpu.methods.active import ActiveScenarios
from vamgpu.methods.corners import ThresholdsOfCorners
from vamgpu.methods.exposure import DoseObjective
from vamgpu.methods.fbp import filtered_light
from vamgpu.methods.method import Criterion, Method, Steps
from vamgpu.methods.minimize import Channel, Pace, minimize
from vamgpu.methods.papers import AUTOMATIC_EXPOSURE, NESTEROV, RAMP, RESTART, THRESHOLDS, TWO_METRIC
from vamgpu.methods.ramp import capped_ramp
from vamgpu.methods.recipe import Recipe
from vamgpu.methods.state import OptimizerState
from vamgpu.targets.limits import Limits

BOTH = 2.0
"""Times shorter that steps are where gray bodies hold doses from both sides: with longer ones hard tasks diverge."""
SPAN = 0.25
"""Share of the columns that the preconditioner reaches over."""


@dataclass(frozen=True)
class ProcessWindow(Method):
    """Recipe passes, then accelerated two-threshold steps preconditioned by a ramp.

    The ramp undoes the blur of projecting and back projecting, so that a step reaches coarse and fine detail alike. An
    iteration is one projector evaluation. Light that is dark and should stay so is left out before the ramp spreads it:
    without that the fixed point is no minimum.

    Args:
        outside: Greatest dose outside the part, in units of the part's dose.
        inside: Least dose in the part, in units of the part's dose.
        most: Greatest dose in the part, in units of the part's dose.
        background: Dose around the part that the recipe aims at, over that of the part.
        passes: Passes of the recipe that come before the accelerated steps.
        cap: Frequency [cycles per column] beyond which the ramp is level.
        step: Length of a step, a factor; 1 is exact for a full inversion.

    Raises:
        BadInput: A value is out of its range.
    """

    outside: float = 0.78
    inside: float = 0.95
    most: float = 1.0
    background: float = 0.6
    passes: int = 2
    cap: float = 0.25
    step: float = 1.0
    papers: ClassVar[tuple[str, ...]] = (THRESHOLDS, AUTOMATIC_EXPOSURE, RAMP, NESTEROV, RESTART, TWO_METRIC)
    iterations: ClassVar[int] = 40
    cost: ClassVar[float] = 1.0
    criterion: ClassVar[Criterion] = "window"
    takes_start: ClassVar[bool] = True

    def __post_init__(self) -> None:
        Band.thresholds(self.outside, self.inside, self.most)
        Recipe(self.background)
        if self.passes < 1 or not 0.0 < self.cap <= 0.5 or not 0.0 < self.step < MOST:
            raise BadInput(f"{self!r}: expected passes ≥ 1, 0 < cap ≤ 0.5 and step > 0")

    @property
    def loss(self) -> Loss:
        """That of the accelerated steps."""
        return Band.thresholds(self.outside, self.inside, self.most)

    def steps(self, state: OptimizerState) -> Steps:
        yield from Recipe(self.background).first(state, self.passes, 0.5 * (self.inside + self.most))
        if "gain" not in state.memory:
            light = state.buffer("light")
            state.memory["gain"] = filtered_light(state, state.volume())
            state.memory["light"] = light
        if state.best.criterion == "loss" and not state.number("judged"):
            state.best.renew()
            state.memory["judged"] = 1.0
        pace = Pace(self.step / state.number("gain"), soon=1.0)
        weight = None if state.limits is None else state.device.upload(_levelled(state.limits))
        active, objective = ActiveScenarios(state, 0.0), None
        if active.scenarios is None or state.best.criterion == "loss":
            loss = self.loss if weight is None else self.loss.weighted(weight)
            objective = DoseObjective(state, loss, pace)
        else:
            objective = ThresholdsOfCorners(state, active, self.inside - self.outside, self.most, pace, weight)
        channel = Channel(state, capped_ramp(state.operator, self.cap, SPAN))
        yield from minimize(objective, (channel,), pace)


def _levelled(limits: Limits) -> np.ndarray:
    """Weights that make no voxel steeper than those of a part alone, for which the step is right, [x, y, z]."""
    heaviest = float(limits.weight[limits.judged].max())
    return (limits.dose**2 / (heaviest * (BOTH if limits.gray.any() else 1.0))).astype(np.float32)

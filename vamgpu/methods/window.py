"""The default: a process window as wide as asked, by accelerated steps through a capped ramp."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from vamgpu.errors import BadInput
from vamgpu.losses.band import MOST, Band
from vamgpu.losses.loss import Loss
from vamgpu.methods.exposure import Exposure
from vamgpu.methods.method import Criterion, Steps
from vamgpu.methods.minimize import Channel, Pace, minimize
from vamgpu.methods.papers import AUTOMATIC_EXPOSURE, NESTEROV, RAMP, RESTART, THRESHOLDS, TWO_METRIC
from vamgpu.methods.ramp import capped_ramp
from vamgpu.methods.recipe import Recipe
from vamgpu.methods.work import Work

SPAN = 0.25
"""Share of the columns that the preconditioner reaches over."""


@dataclass(frozen=True)
class ProcessWindow:
    """Recipe passes, then accelerated two-threshold steps preconditioned by a ramp; one projector pair an iteration.

    The ramp undoes the blur of projecting and back projecting, so that a step reaches coarse and fine detail alike.
    Light that is dark and should stay so is left out before the ramp spreads it: without that the fixed point is no
    minimum.

    outside, inside, most: thresholds in units of the part's dose.  passes: of the recipe, over ``background``.
    cap: frequency [cycles per column] beyond which the ramp is level.  step: 1 is exact for a full inversion.
    Raises `BadInput`.
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

    def __post_init__(self) -> None:
        Band.thresholds(self.outside, self.inside, self.most)
        Recipe(self.background)
        if self.passes < 1 or not 0.0 < self.cap <= 0.5 or not 0.0 < self.step < MOST:
            raise BadInput(f"{self!r}: wanted passes ≥ 1, 0 < cap ≤ 0.5 and step > 0")

    @property
    def loss(self) -> Loss:
        """That of the accelerated steps."""
        return Band.thresholds(self.outside, self.inside, self.most)

    def steps(self, work: Work) -> Steps:
        yield from self._warm(work)
        work.memory.setdefault("stage", work.iteration)  # from here on the loss is another one
        pace = Pace(self.step / work.number("gain", 1.0), soon=1.0)
        channel = Channel(work, capped_ramp(work.operator, self.cap, SPAN))
        yield from minimize(Exposure(work, self.loss, pace), (channel,), pace)

    def _warm(self, work: Work) -> Steps:
        recipe = Recipe(self.background).steps(work)
        while work.number("warm") < self.passes:
            record = next(recipe)
            work.memory["warm"] = work.number("warm") + 1.0
            if work.number("warm") == self.passes:
                work.memory.pop("model")
                work.scale(0.5 * (self.inside + self.most), work.held("light"), work.held("light"))
            yield record
        recipe.close()

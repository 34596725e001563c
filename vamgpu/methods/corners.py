"""Two thresholds for all corners of tolerances, a little farther apart than the light found so far has them."""

from __future__ import annotations

from math import inf

from vamgpu.backend.array import DeviceArray
from vamgpu.kernels.update import multiply
from vamgpu.losses.band import Band
from vamgpu.losses.loss import Loss
from vamgpu.methods.active import ActiveScenarios
from vamgpu.methods.exposure import DoseObjective
from vamgpu.methods.minimize import Pace
from vamgpu.methods.state import OptimizerState
from vamgpu.operators.compose import combine
from vamgpu.operators.reductions import extent, total
from vamgpu.operators.scenarios import Scenarios

AHEAD = 0.03
"""Window that is asked for beyond the widest one so far."""
MIDDLE = 0.65
"""Dose midway between the thresholds, a share of the most: light that a point spread leaves an edge of is far brighter
without it."""
BRIGHT = 4.0
"""Dose that light has nowhere."""
HEAVIER, LIGHTER, HEAVIEST = 0.3, 0.05, 100.0
"""Share by which a look raises the weight of the voxel that is off the most, others as far as they are off; share by
which it lowers all weights, never below 1; and the greatest weight."""


def owed(state: OptimizerState) -> None:
    """Leave in the memory what voxels that are off weigh, as prices of their limits that come to 1 either side.

    Args:
        state: Of a run by `ThresholdsOfCorners`; its light is exposed at all scenarios.
    """
    scenarios, window = state.operator, state.number("asked")
    assert isinstance(scenarios, Scenarios)
    scenarios.rest((False,) * len(scenarios), None)
    low, wall, void = MIDDLE - 0.5 * window, state.volume(), state.volume()
    state.expose(state.buffer("light"), wall)
    limits = Band.thresholds(low, low + window, BRIGHT).weighted(state.buffer("heavy"))
    limits.value_and_gradient(wall, state.target, wall, state.reach)
    combine(1.0, wall, 0.0, wall, void, floor=0.0)
    combine(-1.0, wall, 0.0, wall, wall, floor=0.0)
    inside, outside = total(wall), total(void)
    if inside > 0.0 and outside > 0.0:
        state.memory["owed"] = combine(1.0 / inside, wall, 1.0 / outside, void, wall)


class ThresholdsOfCorners(DoseObjective):
    """The loss of two thresholds at the scenarios that hold the window; the others are computed at every look alone.

    Light for all corners has a narrow window. Thresholds far apart are missed by most voxels, and the worst ones, which
    make the window, count little among them: so the window asked for is `AHEAD` of the widest so far, up to the
    method's own, and voxels that stay off become heavier, as in Lawson's approximation of least greatest error. Between
    looks a light's window is not known, and none is kept.

    Args:
        state: Of the run.
        active: Its scenarios.
        widest: Window that is asked for at last, of the dose's unit.
        most: Greatest dose in the part.
        pace: That the loss is lowered at; its step is that of all scenarios.
        weight: Of the voxels; None for 1.
    """

    active: ActiveScenarios
    loss: Loss
    widest: float
    most: float
    weight: DeviceArray | None

    def __init__(
        self, state: OptimizerState, active: ActiveScenarios, widest: float, most: float, pace: Pace,
        weight: DeviceArray | None,
    ) -> None:  # fmt: skip
        self.active, self.widest, self.most, self.weight = active, widest, most, weight
        super().__init__(state, self._thresholds(widest), pace)
        if "asked" in state.memory:
            self._ask(state.number("asked"))

    def value(self, carried: float = 0.0) -> tuple[float, float]:
        """Loss of the light ahead at the scenarios that do not rest; the window known last."""
        state, memory, self._projected = self.state, self.state.memory, False
        if "asked" not in memory or self.active.due:
            self._look()
        while True:
            state.expose(state.buffer("ahead"), self.dose)
            loss = state.loss(self.dose, self.loss)
            if loss > 0.0 or memory["asked"] >= self.widest or not self._look():
                return loss, state.number("seen")

    def _look(self) -> bool:
        """Judge the light held at all scenarios; returns whether other scenarios, or another window, are asked for."""
        state, memory, scenarios = self.state, self.state.memory, self.active.scenarios
        assert scenarios is not None
        before = scenarios.resting, memory.get("asked")
        memory["seen"] = self.active.hold(state.buffer("light"), self.dose)
        asked = min(max(memory["seen"], state.best.window, 0.0) + AHEAD, self.widest)
        asked = max(asked, state.number("asked"))
        self._weigh(asked)
        self._ask(asked)
        lit, working = len(scenarios), len(scenarios) - sum(scenarios.resting)
        memory["step"] = state.number("step") * state.number("working", lit) / working
        memory |= {"working": float(working), "loss": inf}
        return (scenarios.resting, asked) != before

    def _weigh(self, window: float) -> None:
        """Make voxels heavier the farther they are off; the dose becomes how far that is."""
        state, memory = self.state, self.state.memory
        if "heavy" not in memory:
            memory["heavy"] = state.volume()
            combine(0.0, self.dose, 0.0, self.dose, memory["heavy"], floor=1.0)
            return
        heavy, off = state.buffer("heavy"), state.volume()
        self._thresholds(window).value_and_gradient(self.dose, state.target, self.dose, state.reach)
        combine(1.0, self.dose, 0.0, self.dose, off, floor=0.0)
        combine(-1.0, self.dose, 2.0, off, off)
        most = extent(off)[1]
        state.device.launch(multiply, x=heavy, y=off, out=off)
        share = HEAVIER / ((1.0 + LIGHTER) * most) if most > 0.0 else 0.0
        combine(1.0 / (1.0 + LIGHTER), heavy, share, off, heavy, floor=1.0)
        combine(-1.0, heavy, 0.0, heavy, heavy, floor=-HEAVIEST)
        combine(-1.0, heavy, 0.0, heavy, heavy)

    def _thresholds(self, window: float) -> Band:
        low = min(max(MIDDLE * self.most - 0.5 * window, 0.0), self.most - window)
        return Band.thresholds(low, low + window, self.most)

    def _ask(self, window: float) -> None:
        """Set the loss to that of thresholds so far apart."""
        self.state.memory["asked"] = window
        loss = self._thresholds(window)
        loss = loss if self.weight is None else loss.weighted(self.weight)
        weighted: Loss = loss.weighted(self.state.buffer("heavy"))
        self.loss = weighted.on(self.state.field)

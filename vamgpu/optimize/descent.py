"""What all gradient methods share: an accelerated, projected, optionally filtered descent that watches its loss."""

from __future__ import annotations

from dataclasses import dataclass

from vamgpu.backend.array import DeviceArray
from vamgpu.operators.reductions import dot
from vamgpu.optimize.band import Band
from vamgpu.optimize.method import Steps
from vamgpu.optimize.ramp import Taps
from vamgpu.optimize.work import Work


@dataclass(frozen=True, eq=False)
class Descent:
    """How to descend a band's loss from ``light`` in memory.

    step: of the first step; None takes one that changes the light by ``share`` of itself, and then grows by ``growth``
    a step.  momentum: constant, or None for Nesterov's k / (k + 3).  Both methods drop their momentum when the loss
    rises, and halve the step when it rises again at once.  order: q in (Σ e^p)^(q/p).
    """

    band: Band
    taps: Taps
    step: float | None = None
    share: float = 0.1
    growth: float = 1.0
    momentum: float | None = None
    order: float | None = None
    weight: DeviceArray | None = None

    def steps(self, work: Work) -> Steps:
        """Steps for ever, or until the loss is zero: nothing is left to gain then."""
        memory = work.memory
        if "ahead" not in memory:
            memory["ahead"] = work.sinogram()
            work.scale(1.0, work.held("light"), work.held("ahead"))
        dose, gradient = work.volume(), work.sinogram()
        while True:
            work.expose(work.held("ahead"), dose)
            window, _ = work.window(dose)
            loss, outer = self._outer(work.loss(dose, self.band, self.weight))
            if loss > 0.0:
                self._watch(work, loss)
                work.project(dose, gradient)
                work.free(work.held("ahead"), gradient)
                self._move(work, gradient, outer)
            yield loss, window
            if loss == 0.0:
                return

    def _outer(self, total: float) -> tuple[float, float]:
        """(Σ)^(q/p) and its derivative by Σ."""
        if self.order is None or total <= 0.0:
            return total, 1.0
        ratio = self.order / self.band.power
        return total**ratio, ratio * total ** (ratio - 1.0)

    def _watch(self, work: Work, loss: float) -> None:
        rose = loss > work.number("loss", float("inf"))
        if rose and work.number("run") <= 1:
            work.memory["step"] = 0.5 * work.number("step")
        work.memory["run"] = 0.0 if rose else work.number("run")
        work.memory["loss"] = loss

    def _move(self, work: Work, gradient: DeviceArray, outer: float) -> None:
        if "step" not in work.memory:
            work.memory["step"] = self.step if self.step is not None else self._first(work, gradient, outer)
        run = work.number("run")
        momentum = run / (run + 3.0) if self.momentum is None else self.momentum * (run > 0)
        work.step(gradient, self.taps, work.number("step") * outer, momentum)
        work.memory["run"] = run + 1.0
        work.memory["step"] = work.number("step") * self.growth

    def _first(self, work: Work, gradient: DeviceArray, outer: float) -> float:
        light = work.held("light")
        return self.share * (dot(light, light) / max(dot(gradient, gradient), 1e-60)) ** 0.5 / outer

"""What all gradient methods share: an accelerated, projected, optionally filtered descent that watches its loss."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import inf

from vamgpu.backend.array import DeviceArray
from vamgpu.methods.band import Band
from vamgpu.methods.method import Steps
from vamgpu.methods.ramp import Taps
from vamgpu.methods.work import Work
from vamgpu.operators.reductions import dot

Loss = Callable[[Work, DeviceArray], float]
"""Sum over voxels of a loss of their dose, which becomes the gradient."""
RETREATS = 24
"""Steps in a row, each half as long as the one before, after which none that helps is expected any more."""


@dataclass(frozen=True, eq=False)
class Descent:
    """How to descend a band's loss from ``light`` in memory; one projector pair a step.

    A step looks at ``ahead``, which momentum carries beyond the light that is held. Doses are linear, so that the dose
    of the light itself, by which light is chosen, follows from that of ``ahead`` without projecting.

    Attributes:
        band: The loss of a voxel.
        taps: Filter of the gradient along r.
        step: Length of the first step; None takes one that changes the light by ``share`` of itself.
        share: See ``step``.
        growth: Of the step, from one to the next; if ``guarded``, after one that lowered the loss.
        momentum: Constant, or None for Nesterov's k / (k + 3).
        order: q in (Σ e^p)^(q/p); None for q = p.
        weight: Of each voxel; None for 1.
        loss: Used instead of the band's where given.
        guarded: What happens where the loss rises. True takes the step back: the light is again the best so far, the
            next step is half as long and without momentum, and the loss never rises from one record to the next. False
            drops the momentum, and halves the step where the loss rises again at once.
    """

    band: Band
    taps: Taps
    step: float | None = None
    share: float = 0.1
    growth: float = 1.0
    momentum: float | None = None
    order: float | None = None
    weight: DeviceArray | None = None
    loss: Loss | None = None
    guarded: bool = False

    def steps(self, work: Work) -> Steps:
        """Steps for ever, or until the loss is zero or no step lowers it: nothing is left to gain then.

        Yields:
            Loss and strict window: of the light held if ``guarded``; else the loss of the point ahead of it, and the
            window of the light that was held before the step.
        """
        memory = work.memory
        if "ahead" not in memory:
            memory["ahead"] = work.sinogram()
            work.scale(1.0, work.held("light"), work.held("ahead"))
        dose, gradient = work.volume(), work.sinogram()
        while True:
            work.expose(work.held("ahead"), dose)
            held = self._dose_of_light(work, dose)
            window, _ = work.window(held)
            loss, outer = self._outer(self._sum(work, dose))
            if loss > 0.0:
                work.project(dose, gradient)
            if self.guarded and held is not dose:
                work.scale(1.0, held, dose)
                loss = self.judge(work, dose)
            returned = memory.pop("returned", False)  # to the best light, whose loss is no progress yet
            if self.guarded and not returned and not loss < work.best.loss:
                self._retreat(work)
                if "best" in memory:
                    loss, window = work.best.loss, work.best.window
            else:
                better = work.offer(loss, window, 0)
                if better:
                    memory["retreats"] = 0.0
                if "step" in memory and (better or not self.guarded):
                    memory["step"] = work.number("step") * self.growth
                self._advance(work, gradient, loss, outer)
            yield loss, window
            if loss == 0.0 or work.number("retreats") >= RETREATS:
                return

    def judge(self, work: Work, dose: DeviceArray) -> float:
        """Loss of a dose, which is overwritten."""
        return self._outer(self._sum(work, dose))[0]

    def _sum(self, work: Work, dose: DeviceArray) -> float:
        """Sum over voxels; the dose becomes its gradient."""
        return self.loss(work, dose) if self.loss is not None else work.loss(dose, self.band, self.weight)

    def _outer(self, total: float) -> tuple[float, float]:
        """(Σ)^(q/p) and its derivative by Σ."""
        if self.order is None or total <= 0.0:
            return total, 1.0
        ratio = self.order / self.band.power
        return total**ratio, ratio * total ** (ratio - 1.0)

    def _dose_of_light(self, work: Work, ahead: DeviceArray) -> DeviceArray:
        """Dose of ``light`` from that of ``ahead`` = light + m·(light − the light before it)."""
        if self.momentum == 0.0:
            return ahead
        carried = work.number("carried")
        if "dose" not in work.memory:
            work.memory["dose"], carried = work.volume(), 0.0
        dose = work.held("dose")
        if carried:
            work.combine(1.0 / (1.0 + carried), ahead, carried / (1.0 + carried), dose, dose)
        else:  # what is in a new volume may be no number
            work.scale(1.0, ahead, dose)
        return dose

    def _advance(self, work: Work, gradient: DeviceArray, loss: float, outer: float) -> None:
        """Move the light, unless nothing is left to gain."""
        if loss > 0.0:
            if not self.guarded:
                self._watch(work, loss)
            work.free(work.held("ahead"), gradient)
            self._move(work, gradient, outer)
            work.best.unseen = lambda dose: self.judge(work, dose)

    def _watch(self, work: Work, loss: float) -> None:
        rose = loss > work.number("loss", inf)
        if rose and work.number("run") <= 1:
            work.memory["step"] = 0.5 * work.number("step")
        work.memory["run"] = 0.0 if rose else work.number("run")
        work.memory["loss"] = loss

    def _retreat(self, work: Work) -> None:
        """Go back to the best light, if there is one yet, and be more careful."""
        memory = work.memory
        if "best" in memory:
            for name in ("light", "ahead"):
                work.scale(1.0, work.held("best"), work.held(name))
        memory.update({"step": 0.5 * work.number("step"), "run": 0.0, "carried": 0.0, "returned": True})
        memory["retreats"] = work.number("retreats") + 1.0
        work.best.unseen = None

    def _move(self, work: Work, gradient: DeviceArray, outer: float) -> None:
        if "step" not in work.memory:
            work.memory["step"] = self.step if self.step is not None else self._first(work, gradient, outer)
        run = work.number("run")
        momentum = run / (run + 3.0) if self.momentum is None else self.momentum * (run > 0)
        work.step(gradient, self.taps, work.number("step") * outer, momentum)
        work.memory.update({"run": run + 1.0, "carried": momentum})

    def _first(self, work: Work, gradient: DeviceArray, outer: float) -> float:
        light = work.held("light")
        return self.share * (dot(light, light) / max(dot(gradient, gradient), 1e-60)) ** 0.5 / outer

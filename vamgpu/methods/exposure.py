"""What one light is judged by: the loss of its dose, and the price of bright light."""

from __future__ import annotations

from vamgpu.backend.array import DeviceArray
from vamgpu.losses.loss import Loss
from vamgpu.methods.minimize import Pace
from vamgpu.methods.work import Work


class Exposure:
    """The loss of the dose Aᵀg of light g, plus price·Σ g^power.

    A step looks at ``ahead``, which momentum carries beyond the light that is held. Doses are linear, so that the dose
    of the light itself, by which light is chosen, follows from that of ``ahead`` without projecting. Half a pair for a
    value, half for a gradient.

    Args:
        work: Of the run; lines are searched for from ``light`` in its memory, steps taken from ``ahead``.
        loss: Of the dose.
        pace: That it is lowered at.
        price: Of light, and its power; for steps that are searched for.
        rest: Dose that other light brings.
        dose: To work in; None for a new volume.
        gradient: To work in; None for a new sinogram.
    """

    def __init__(
        self, work: Work, loss: Loss, pace: Pace, *, price: tuple[float, float] = (0.0, 1.0),
        rest: DeviceArray | None = None, dose: DeviceArray | None = None, gradient: DeviceArray | None = None,
    ) -> None:  # fmt: skip
        self.work, self.loss, self.pace, self.price, self.rest = work, loss.on(work.field), pace, price, rest
        self.dose = work.volume() if dose is None else dose
        if pace.history and "gradient" not in work.memory:
            work.memory["gradient"] = work.sinogram()
        kept = work.memory.get("gradient") if pace.history else gradient
        self._gradient = work.sinogram() if kept is None else kept
        self._at = "light" if pace.history else "ahead"
        self._projected = False

    def value(self, carried: float = 0.0) -> tuple[float, float]:
        work, pace, self._projected = self.work, self.pace, False
        work.expose(work.held(self._at), self.dose)
        if self.rest is not None:
            work.combine(1.0, self.dose, 1.0, self.rest, self.dose)
        held = self._dose_of_light(carried)
        window = 0.0 if pace.fixed else work.window(held)[0]
        loss = work.loss(self.dose, self.loss) + self._bright()
        if pace.back <= 1.0 and loss > 0.0:  # projected also where the step is taken back: an iteration is one pair
            self.gradient()
        if pace.back <= 1.0 and held is not self.dose:  # the loss that counts is that of the light held
            work.scale(1.0, held, self.dose)
            loss = work.loss(self.dose, self.loss)
        return loss, window

    def gradient(self) -> tuple[DeviceArray]:
        if not self._projected:
            self.work.project(self.dose, self._gradient)
            self._bright()
            self._projected = True
        return (self._gradient,)

    def _bright(self) -> float:
        """What the light costs; its derivative is added to the gradient, which a value overwrites in vain."""
        price, power = self.price
        if not price:
            return 0.0
        return self.work.free(self.work.held(self._at), self._gradient, price, power, hold=False)

    def _dose_of_light(self, carried: float) -> DeviceArray:
        """Dose of ``light`` from that of ``ahead`` = light + m·(light − the light before it)."""
        pace, memory, work = self.pace, self.work.memory, self.work
        if pace.history or pace.fixed or pace.momentum == 0.0:
            return self.dose
        if "dose" not in memory:
            memory["dose"], carried = work.volume(), 0.0
        dose = work.held("dose")
        if carried:
            work.combine(1.0 / (1.0 + carried), self.dose, carried / (1.0 + carried), dose, dose)
        else:  # what is in a new volume may be no number
            work.scale(1.0, self.dose, dose)
        return dose

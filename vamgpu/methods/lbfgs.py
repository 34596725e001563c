"""L-BFGS on the two-threshold loss, with a price on bright light."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from vamgpu.backend.array import DeviceArray
from vamgpu.errors import BadInput
from vamgpu.methods.band import GREATEST_POWER, MOST, Band
from vamgpu.methods.fbp import filtered_light
from vamgpu.methods.method import Criterion, Steps
from vamgpu.methods.pairs import Pairs
from vamgpu.methods.papers import LIMITED_MEMORY, THRESHOLDS
from vamgpu.methods.work import Work
from vamgpu.operators.reductions import dot

TRIES = 12


@dataclass(frozen=True)
class LBFGS:
    """Projected limited-memory quasi-Newton steps with backtracking.

    outside, inside, most: thresholds in units of the part's dose.  efficiency: price of bright light against a part
    that is all wrong by one; with power 4 it is the few brightest pixels that cost, which dim the rest of a print: the
    mean over the greatest light rises.  power: of that price, ≥ 1; 1 asks for little light instead.
    history: pairs of sinograms kept.  history_bytes: memory they may take; None takes what the device gives. Fewer
    pairs than asked raise a `MemoryNotice`.  Raises `BadInput`.
    """

    outside: float = 0.8
    inside: float = 0.95
    most: float = 1.0
    efficiency: float = 0.0
    power: float = 4.0
    history: int = 5
    history_bytes: int | None = None
    papers: ClassVar[tuple[str, ...]] = (LIMITED_MEMORY, THRESHOLDS)
    iterations: ClassVar[int] = 40
    cost: ClassVar[float] = 1.0
    criterion: ClassVar[Criterion] = "loss"

    def __post_init__(self) -> None:
        self._band()
        counted = isinstance(self.history, int) and self.history >= 1
        if not (counted and 0 <= self.efficiency < MOST and 1 <= self.power <= GREATEST_POWER):
            raise BadInput(
                f"{self!r}: wanted efficiency ≥ 0, a power from 1 to {GREATEST_POWER:g} and a whole history ≥ 1"
            )

    def _band(self) -> Band:
        return Band.thresholds(self.outside, self.inside, self.most)

    def steps(self, work: Work) -> Steps:
        dose = work.volume()
        if "light" not in work.memory:
            filtered_light(work, dose)
        if "gradient" not in work.memory:
            work.memory["price"] = self._price(work)
            loss, work.memory["window"] = self._loss(work, dose)
            work.memory["gradient"] = work.sinogram()
            work.memory["loss"] = self._gradient(work, dose, loss)
        pairs = Pairs(work, self.history, self.history_bytes)
        direction = work.sinogram()
        while True:
            pairs.direct(direction)
            pairs.open()
            self._search(work, pairs, direction, dose)
            yield work.number("loss"), work.number("window")
            if work.number("stuck"):
                return

    def _price(self, work: Work) -> float:
        if not self.efficiency:
            return 0.0
        light, slope = work.held("light"), work.sinogram()
        total = work.free(light, slope, 1.0, self.power, hold=False)
        return self.efficiency * dot(work.target, work.target) / max(total, 1e-60)

    def _loss(self, work: Work, dose: DeviceArray) -> tuple[float, float]:
        """Loss without the price of light, and window; dose becomes the gradient."""
        work.expose(work.held("light"), dose)
        window, _ = work.window(dose)
        return work.loss(dose, self._band()), window

    def _gradient(self, work: Work, slopes: DeviceArray, loss: float) -> float:
        """Put the gradient by light into memory; returns the whole loss."""
        gradient = work.held("gradient")
        work.project(slopes, gradient)
        return loss + work.free(work.held("light"), gradient, work.number("price"), self.power, hold=False)

    def _search(self, work: Work, pairs: Pairs, direction: DeviceArray, dose: DeviceArray) -> None:
        """Move light along the direction, shorter until the loss falls; update gradient and history."""
        light, gradient = work.held("light"), work.held("gradient")
        before = work.number("loss")
        share = 1.0 if pairs.used else 0.05 * (dot(light, light) / max(dot(direction, direction), 1e-60)) ** 0.5
        work.scale(1.0, light, pairs.step)
        work.scale(1.0, gradient, pairs.change)
        for _ in range(TRIES):
            if not work.affords(1.0):
                break
            work.combine(1.0, pairs.step, share, direction, light, floor=0.0)
            loss, window = self._loss(work, dose)
            if loss + self._bright(work) < before:
                work.memory.update({"loss": self._gradient(work, dose, loss), "window": window})
                pairs.close(light, gradient)
                return
            share *= 0.4
        work.scale(1.0, pairs.step, light)
        work.scale(1.0, pairs.change, gradient)
        work.memory["stuck"] = float(not pairs.used and work.affords(1.0))
        pairs.forget()

    def _bright(self, work: Work) -> float:
        price = work.number("price")
        if not price:
            return 0.0
        # The gradient in memory is of the last light and saved in the history: here it only takes the price's sum
        return work.free(work.held("light"), work.held("gradient"), price, self.power, hold=False)

"""L-BFGS on the two-threshold loss, with a price on bright light."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from vamgpu.errors import BadInput
from vamgpu.losses.band import GREATEST_POWER, MOST, Band
from vamgpu.losses.loss import Loss
from vamgpu.methods.exposure import Exposure
from vamgpu.methods.fbp import filtered_light
from vamgpu.methods.method import Criterion, Steps
from vamgpu.methods.minimize import Channel, Pace, minimize
from vamgpu.methods.papers import LIMITED_MEMORY, THRESHOLDS
from vamgpu.methods.ramp import identity
from vamgpu.methods.work import Work
from vamgpu.operators.reductions import dot


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
        Band.thresholds(self.outside, self.inside, self.most)
        counted = isinstance(self.history, int) and self.history >= 1
        if not (counted and 0 <= self.efficiency < MOST and 1 <= self.power <= GREATEST_POWER):
            raise BadInput(
                f"{self!r}: wanted efficiency ≥ 0, a power from 1 to {GREATEST_POWER:g} and a whole history ≥ 1"
            )

    @property
    def loss(self) -> Loss:
        """That of doses."""
        return Band.thresholds(self.outside, self.inside, self.most)

    @property
    def coupling(self) -> str:
        """Why places far apart on a web depend on each other; empty where they do not."""
        if not self.efficiency:
            return ""
        return f"efficiency is {self.efficiency}: its price is set by all light of a web; wanted 0"

    def steps(self, work: Work) -> Steps:
        if "light" not in work.memory:
            filtered_light(work, work.volume())
        if "price" not in work.memory:
            work.memory["price"] = self._price(work)
        pace = Pace(history=self.history, history_bytes=self.history_bytes)
        exposure = Exposure(work, self.loss, pace, price=(work.number("price"), self.power))
        yield from minimize(exposure, (Channel(work, identity(work.operator)),), pace)

    def _price(self, work: Work) -> float:
        if not self.efficiency:
            return 0.0
        light, slope = work.held("light"), work.sinogram()
        total = work.free(light, slope, 1.0, self.power, hold=False)
        return self.efficiency * dot(work.target, work.target) / max(total, 1e-60)

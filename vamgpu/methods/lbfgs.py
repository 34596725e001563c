"""L-BFGS on the two-threshold loss, with a penalty on bright light."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import ClassVar

from vamgpu.errors import BadInput
from vamgpu.geometry import positive
from vamgpu.losses.band import GREATEST_POWER, MOST, Band
from vamgpu.losses.loss import Loss
from vamgpu.methods.exposure import lower
from vamgpu.methods.method import Method, Steps
from vamgpu.methods.minimize import StepRule, check_pairs
from vamgpu.methods.papers import LIMITED_MEMORY, THRESHOLDS
from vamgpu.methods.state import OptimizerState


class ByPairs(Method):
    """Common part of methods that minimize losses with dose thresholds by limited-memory quasi-Newton steps."""

    outside: float
    inside: float
    most: float
    history: int
    history_bytes: int | None
    papers: ClassVar[tuple[str, ...]] = (LIMITED_MEMORY, THRESHOLDS)
    iterations: ClassVar[int] = 40
    takes_start: ClassVar[bool] = True

    @property
    @abstractmethod
    def loss(self) -> Loss:
        """Loss of the dose. Raises `BadInput` for thresholds that are not in order."""
        ...

    @property
    def rule(self) -> StepRule:
        """Rule for the steps that lower the loss."""
        return StepRule(history=self.history, history_bytes=self.history_bytes)

    def __post_init__(self) -> None:
        for name in ("outside", "inside", "most"):
            positive(name, getattr(self, name), zero=True)
        _ = self.loss
        check_pairs(self.history)
        if self.history_bytes is not None:
            positive("history_bytes", self.history_bytes, zero=True)


@dataclass(frozen=True)
class LBFGS(ByPairs):
    """Projected limited-memory quasi-Newton steps with backtracking.

    Args:
        outside: Greatest dose outside the part, in units of the part's dose.
        inside: Least dose in the part, in units of the part's dose.
        most: Greatest dose in the part, in units of the part's dose.
        efficiency: Weight of the penalty on bright pixels, relative to the loss if every voxel is wrong by 1. With
            power 4, it mainly penalizes the few brightest pixels; the ratio of mean to greatest light then rises.
        power: Exponent of that penalty, ≥ 1; 1 penalizes all light.
        history: Largest number of stored pairs of sinograms.
        history_bytes: Memory limit of these pairs; None for the device's free memory. A `MemoryNotice` reports if fewer
            pairs fit.

    Raises:
        BadInput: A value is out of its range.
    """

    outside: float = 0.8
    inside: float = 0.95
    most: float = 1.0
    efficiency: float = 0.0
    power: float = 4.0
    history: int = 5
    history_bytes: int | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (0 <= self.efficiency < MOST and 1 <= self.power <= GREATEST_POWER):
            raise BadInput(f"{self!r}: expected efficiency ≥ 0 and a power from 1 to {GREATEST_POWER:g}")

    @property
    def loss(self) -> Loss:
        """Two thresholds of the dose, outside the part and in it."""
        return Band.thresholds(self.outside, self.inside, self.most)

    @property
    def coupling(self) -> str:
        """Reason why distant positions on a web depend on each other; empty if they do not."""
        if not self.efficiency:
            return ""
        return f"efficiency is {self.efficiency}: its penalty depends on all light of a web; expected 0"

    def steps(self, state: OptimizerState) -> Steps:
        yield from lower(state, self.loss, self.rule, efficiency=self.efficiency, power=self.power)

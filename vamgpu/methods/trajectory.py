"""Course of the losses of a run: whether they fell, and where they began to rise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite

BLOWN = 1e3  # multiple of the first loss above which a run is given up
LOST = 0.5  # a rise by more than this share of the descent is a divergence, not an oscillation
SWING = 0.05  # relative rise over the least loss that is never reported


@dataclass(frozen=True)
class LossTrajectory:
    """Losses of one kind, one per iteration."""

    losses: Sequence[float]
    start: int = 0

    @property
    def lost(self) -> bool:
        """Whether the last loss is not a finite number."""
        return not isfinite(self.losses[-1])

    @property
    def blown(self) -> bool:
        """Whether the last loss exceeds the first by far."""
        return self.losses[-1] > BLOWN * self.losses[0] > 0.0

    @property
    def risen(self) -> bool:
        """Whether more than half of the descent was lost again; rises within 5 % of the least loss do not count."""
        first, last, least = self.losses[0], self.losses[-1], self.losses[self._least]
        return last - least > LOST * (first - least) + SWING * least

    @property
    def began(self) -> int:
        """The iteration, counted from 1, with the least loss."""
        return self.start + self._least + 1

    @property
    def _least(self) -> int:
        finite = [loss if isfinite(loss) else float("inf") for loss in self.losses]
        return finite.index(min(finite))

    def message(self, light: str = "the plan holds the best light before that") -> str:
        """What happened, from which iteration on, which light is returned, and what to do."""
        least, last, end = self.losses[self._least], self.losses[-1], self.start + len(self.losses)
        return (
            f"the loss rose from {least:.4g} at iteration {self.began} to {last:.4g} at iteration {end}: the method "
            f"diverged from there on; {light}. Take shorter steps (a smaller share, growth, step or gain) or fewer "
            "iterations"
        )

"""How the losses of a run went: whether they fell, and where they began to rise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite

BLOWN = 1e3
"""Times the first loss: from there nothing good is to be expected."""
LOST = 0.5
"""Share of the descent which, lost again, counts as divergence rather than as a swing."""
SWING = 0.05
"""Rise over the least loss that is never spoken of."""


@dataclass(frozen=True)
class LossTrajectory:
    """Losses of one meaning, one an iteration."""

    losses: Sequence[float]
    start: int = 0

    @property
    def lost(self) -> bool:
        """Whether the last loss is no finite number."""
        return not isfinite(self.losses[-1])

    @property
    def blown(self) -> bool:
        """Whether the last loss is out of all proportion to the first."""
        return self.losses[-1] > BLOWN * self.losses[0] > 0.0

    @property
    def risen(self) -> bool:
        """Whether more than half of the descent is lost again; rises within 5 % of the least loss do not count."""
        first, last, least = self.losses[0], self.losses[-1], self.losses[self._least]
        return last - least > LOST * (first - least) + SWING * least

    @property
    def began(self) -> int:
        """The iteration, counted from 1, after which no loss was as small as at it."""
        return self.start + self._least + 1

    @property
    def _least(self) -> int:
        finite = [loss if isfinite(loss) else float("inf") for loss in self.losses]
        return finite.index(min(finite))

    def message(self, light: str = "the plan holds the best light of before") -> str:
        """What happened, from which iteration on, what became of the light, and what to do."""
        least, last, end = self.losses[self._least], self.losses[-1], self.start + len(self.losses)
        return (
            f"the loss rose from {least:.4g} at iteration {self.began} to {last:.4g} at iteration {end}: the method "
            f"diverged from there on; {light}. Take shorter steps (a smaller share, growth, step or gain) or fewer "
            "iterations"
        )

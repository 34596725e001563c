"""Frames of a vial whose light is in doubt: which of them may be shown again."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

from vamgpu.printing.given_dose import GivenDose


class Mending:
    """Counts frames shown again: one in doubt had none to all of its light, so that a second may be too much."""

    def __init__(self, dose: GivenDose | None, spare: float) -> None:
        self._dose, self._spare, self._spent = dose, spare, 0.0
        self._frames: Counter[int] = Counter()

    def refused(self, frames: Iterable[int], light: float) -> str | None:
        """Why frames may not be shown again with their light; None if they may, and are counted."""
        if self._dose is None:
            return "the proved dose is not known"
        counts = self._frames + Counter(frames)
        most = self._dose.share * (1.0 + max(counts.values(), default=0) / self._dose.turns)
        if most > self._dose.proved.most:
            return f"the dose could reach ×{most:.3f}; expected ×{self._dose.proved.most:.3f} at most"
        if self._spent + light > self._spare:
            return f"they need {self._spent + light:.3g} of light; the budget has {self._spare:.3g} over the plan"
        self._frames, self._spent = counts, self._spent + light
        return None

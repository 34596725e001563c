"""How fast a part sinks: by its distance below the light that made it, turn by turn."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

USUAL = 0.1  # standard deviation of the speed before anything is seen [pixels per turn]
LEAST = 0.05  # least standard deviation of a distance [pixels]
SURE = 2.0  # standard deviations by which a speed must differ from 0


@dataclass(frozen=True)
class Sinking:
    """What is known of it after a turn. Light is counted in planned turns."""

    found: float = 0.0  # speed [pixels per turn]
    error: float = USUAL  # its standard deviation
    lit: float = 0.0  # light so far, summed over the turns
    lowered: float = 0.0  # light, times the distance by which it has been lowered since it was shown
    seen: tuple[tuple[float, float, float], ...] = ()  # of each estimate: ``lit``, light times distance, its deviation

    @property
    def speed(self) -> float:
        """The speed if it certainly differs from 0, else 0."""
        return self.found if abs(self.found) > SURE * self.error else 0.0

    def turned(self, light: float) -> Sinking:
        """One turn later; light: before that turn."""
        return replace(self, lit=self.lit + light, lowered=self.lowered + self.speed * light)

    def estimated(self, distance: float, error: float, light: float) -> Sinking:
        """From a distance of the part below all the lowered light, and its deviation: what sinks moves all of it."""
        seen = *self.seen, (self.lit, self.lowered + distance * light, max(error, LEAST) * light)
        lit, moved, deviation = np.transpose(seen)
        weight = deviation**-2.0
        after, further = (each - np.average(each, weights=weight) for each in (lit, moved))
        known = USUAL**-2.0 + float((weight * after**2).sum())
        return replace(self, seen=seen, found=float((weight * after * further).sum()) / known, error=known**-0.5)

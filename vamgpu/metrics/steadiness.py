"""Thresholds between which a print keeps its bodies, holes, walls and gaps."""

from __future__ import annotations

from dataclasses import astuple, dataclass
from math import ceil, log, sqrt

import numpy as np

from vamgpu.backend.cores import together
from vamgpu.metrics.body_changes import BodyChanges, body_changes
from vamgpu.metrics.printed_field import PrintedField
from vamgpu.metrics.runs import runs_of
from vamgpu.metrics.topology import Topology, topology
from vamgpu.metrics.walls import Walls

LOST = 0.05  # share of the part's surface at which walls may vanish, or gaps close
FARTHEST = 2.0  # greatest ratio of two thresholds that are compared
WAY = 2.0**0.25
"""Greatest ratio of neighboring thresholds on the way to either end: a hole may open at one and be gone at the next."""
CLOSE = 0.005  # relative distance between the last threshold that keeps the print and the first that does not


@dataclass(frozen=True, eq=False)
class Print:
    """A print, its part, and the middles of the part's walls and gaps at points of its surface."""

    around: PrintedField
    part: Topology
    changes: BodyChanges  # of this print
    middles: tuple[Walls, Walls]

    def thresholds(self, lowest: float, highest: float) -> tuple[float, float] | None:
        """The lowest and the highest threshold, within limits, that change nothing; None if a body is wrong already."""
        if not self.changes.none:
            return None
        at, spare = self.around.threshold, int(LOST * len(self.middles[0].is_wall))
        thick, wide = (self.around.dose(found.center[found.is_wall]) for found in self.middles)
        printed, empty = np.sort(thick[thick >= at]), np.sort(wide[wide < at])[::-1]
        lowest = max(lowest, at / FARTHEST, *empty[spare : spare + 1].tolist())
        highest = min(highest, at * FARTHEST, *printed[spare : spare + 1].tolist())
        low, high = together(lambda: self._last(min(lowest, at)), lambda: self._last(max(highest, at)))
        return low, high

    def _last(self, end: float) -> float:
        """The last threshold on the way from the print's own to an end at which its bodies are no worse."""
        at = good = bad = self.around.threshold
        steps = ceil(abs(log(end / at)) / log(WAY) - 1e-9)
        for step in range(1, steps + 1):
            good, bad = bad, at * (end / at) ** (step / steps)
            if not self._keeps(bad):
                break
        else:
            return end
        while abs(log(bad / good)) > CLOSE:
            middle = sqrt(good * bad)
            good, bad = (middle, bad) if self._keeps(middle) else (good, middle)
        return good

    def _keeps(self, level: float) -> bool:
        """Whether bodies, holes and cavities at a threshold differ no more from the part's than those of the print."""
        found = body_changes(self.part, topology(runs_of(self.around.values, level)), self.around.pitch**3)
        return bool((np.array(astuple(found)) <= np.array(astuple(self.changes))).all())

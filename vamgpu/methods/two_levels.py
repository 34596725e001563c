"""Light of two levels with a wide window: splitting steps whose light is driven to its ends.

Light is held between its levels at a price that is concave, which pushes it away from their middle. (R. Takapoui, N.
Moehle, S. Boyd, A. Bemporad, Int. J. Control 93 (2020) 2, round in its place, from the first step on.) What a pixel
loses by the push all others make up for in the same step, and the push grows as long as they can.
"""

from __future__ import annotations

from collections.abc import Iterator

from vamgpu.backend.array import DeviceArray
from vamgpu.methods.projector import Projector
from vamgpu.methods.split import split_steps
from vamgpu.methods.state import OptimizerState
from vamgpu.operators.compose import combine
from vamgpu.operators.reductions import extent

PUSH = (0.01, 0.3)
"""Of the first rising step and of the last, over the distance from the middle."""
OFTEN = 5
"""Steps between lights that are worth a look."""

CALM, RISING = 40, 100
"""Steps without a push, in which light gets used to its greatest, and steps in which it grows."""


class TwoLevels:
    """Seeks light of two levels that leaves a wide window, from light of any.

    Args:
        operator: Makes dose of light.
        target: Fractions [x, y, z].
        light: To begin with [angle, r, z].
    """

    possible: bool

    def __init__(self, operator: Projector, target: DeviceArray, light: DeviceArray) -> None:
        self._light, self._state = light, OptimizerState(operator, target, {})
        self._run = split_steps(self._state)
        self.possible = self._run is not None

    def seek(self, full: float, black: float = 0.0) -> Iterator[DeviceArray]:
        """Drive light to its ends.

        Args:
            full, black: Its two levels.

        Yields:
            Light to be rounded to the nearer level, for the window of that; it is the next one's room. Nothing where
            light cannot be split (`possible`).
        """
        state, run = self._state, self._run
        if run is None:
            return
        state.memory["light"] = self._light
        run.begin()
        free, owed, shown = state.buffer("free"), state.buffer("light owed"), state.sinogram()
        unit = extent(self._light)[1] / extent(free)[1]
        for step in range(1, CALM + RISING + 1):
            risen = (step - CALM) / RISING
            push = PUSH[0] * (PUSH[1] / PUSH[0]) ** risen if risen > 0.0 else 0.0
            run.step(black / unit, full / unit, push)
            if risen > 0.0 and step % OFTEN == 0:
                yield combine(2.0 * unit, free, unit, owed, shown, floor=0.0)

"""Light of two levels with a wide window: splitting steps whose light is driven to its ends.

Light is held between its levels at a price that is concave, which pushes it away from their middle; R. Takapoui, N.
Moehle, S. Boyd, A. Bemporad, Int. J. Control 93 (2020) 2, take the nearer level itself in every step. What a pixel
loses by the push all others make up for in the same step, and the push grows as long as they can.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from vamgpu.backend.array import DeviceArray
from vamgpu.kernels.split import split_two_levels
from vamgpu.methods.projector import Projector
from vamgpu.methods.split import split_steps
from vamgpu.methods.state import OptimizerState
from vamgpu.operators.compose import combine
from vamgpu.operators.reductions import extent

PUSH = (0.005, 0.3)
"""Of the first step and of the last, over the distance from the middle."""
STEPS, OFTEN = 120, 5
"""Steps in all, and from one light that is worth a look to the next."""


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

    def seek(self, white: DeviceArray) -> Iterator[DeviceArray]:
        """Drive light to its ends.

        Args:
            white: Light of every pixel that is on [angle, r, z]; one that is off counts as dark.

        Yields:
            Light to be rounded to the nearer level, for the window of that; it is the next one's room. Nothing where
            light cannot be split (`possible`).

        Raises:
            OutOfMemory: The device is too small.
        """
        state, run = self._state, self._run
        if run is None:
            return
        state.memory["light"] = self._light
        run.begin()
        free, shown, levels = state.buffer("free"), state.sinogram(), state.sinogram()
        unit = extent(self._light)[1] / extent(free)[1]
        state.scale(1.0 / unit, white, levels)
        for step in range(1, STEPS + 1):
            push = PUSH[0] * (PUSH[1] / PUSH[0]) ** (step / STEPS)
            run.step(partial(state.device.launch, split_two_levels, white=levels, push=push))
            if step % OFTEN == 0:
                yield combine(unit, free, 0.0, free, shown, floor=0.0)

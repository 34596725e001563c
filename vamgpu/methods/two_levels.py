"""Light of two levels with a wide window, by ADMM with a push towards the two levels.

    maximize a − b   over g, a, b   subject to   a ≤ (Aᵀg)ᵢ ≤ 1 in the part,   (Aᵀg)ᵢ ≤ b outside,   0 ≤ g ≤ white

With copies z of the dose and w of the light, and scaled duals u and v (see `vamgpu.kernels.admm`), a step is
    z = clip(Aᵀg + u),  w = clip(g + v + push·(g + v − white/2)),
    g ← argmin |Aᵀg − z + u|² + |g − w + v|²,  u ← u + Aᵀg − z,  v ← v + g − w,
each with over-relaxation; the push is a concave penalty, and `GramInverse` finds the argmin.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from math import inf, sqrt
from typing import Any

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.errors import OutOfMemory
from vamgpu.kernels.admm import clip_dose, clip_light, find_levels
from vamgpu.methods.state import OptimizerState
from vamgpu.operators.compose import combine
from vamgpu.operators.gram import RIM, GramInverse
from vamgpu.operators.protocol import Operator
from vamgpu.operators.reductions import extent, parts_for, sums
from vamgpu.operators.scenarios import Scenarios

PUSH = (0.005, 0.3)  # push of the first step and of the last, relative to the distance from the middle
STEPS, OFTEN = 120, 5  # number of steps, and of steps between two results that are evaluated
BACKGROUND = 0.6  # greatest dose outside, relative to that of the part, at which the search for limits starts
LACK = 0.04
"""Total dose, divided by the number of voxels, that voxels of the part may lack where limits are searched; for
scenarios, divided by the root of that number, because their voxels stand for each other."""
RELAX = 1.6  # over-relaxation of a step towards the limits; below 2
CLOSE, PASSES = 1e-3, 12  # tolerance of the limits as a share of that lack, and greatest number of trials


class TwoLevels:
    """Finds two-level light with a wide window, starting from any light."""

    def __init__(self, operator: Operator, target: DeviceArray, light: DeviceArray) -> None:
        self._light, self._state = light, OptimizerState(operator, target, {})
        self._inverse: GramInverse | None = None
        if not GramInverse.unsupported_reason(operator):
            with suppress(OutOfMemory):
                self._inverse = GramInverse(operator, self._state.reach, RIM)
        self.possible: bool = self._inverse is not None

    def seek(self, white: DeviceArray) -> Iterator[DeviceArray]:
        """Drive light to its two levels."""
        if self._inverse is None:
            return
        state, run = self._state, ADMM(self._state, self._inverse, self._light)
        shown, levels = state.sinogram(), state.sinogram()
        state.scale(1.0 / run.unit, white, levels)
        for step in range(1, STEPS + 1):
            run.step(levels, PUSH[0] * (PUSH[1] / PUSH[0]) ** (step / STEPS))
            if step % OFTEN == 0:
                yield combine(run.unit, run.light, 0.0, run.light, shown, floor=0.0)


class ADMM:
    """One run: light, its dose, and the scaled duals of both, in units of the greatest dose."""

    def __init__(self, state: OptimizerState, inverse: GramInverse, light: DeviceArray) -> None:
        self.state: OptimizerState = state
        self.inverse: GramInverse = inverse
        self.light: DeviceArray = state.sinogram()
        self.dose: DeviceArray = state.volume()
        state.expose(light, self.dose)
        self.unit: float = max(extent(self.dose)[1], 1e-30)
        state.scale(1.0 / self.unit, light, self.light)
        state.scale(1.0 / self.unit, self.dose, self.dose)
        self.dose_dual: DeviceArray = combine(-1.0, self.dose, 0.0, self.dose, state.volume())
        self.light_dual: DeviceArray = combine(-1.0, self.light, 0.0, self.light, state.sinogram())
        self.least: float = 1.0
        self.leak: float = BACKGROUND
        self.pull: DeviceArray = state.volume()
        self.way: DeviceArray = state.sinogram()
        count = len(state.operator) if isinstance(state.operator, Scenarios) else 1
        voxels = float(np.count_nonzero(state.evaluation_mask() * state.target.numpy() >= 0.5))
        self.lack: float = LACK * voxels / sqrt(count)

    def step(self, white: DeviceArray, push: float) -> None:
        """Clip dose and light to their limits, then find the light closest to both."""
        state, launch = self.state, self.state.device.launch
        self.least, self.leak = found_levels(self._point(), self.lack)
        launch(clip_dose, **self._point(), relax=RELAX, pull=self.pull)
        state.project(self.pull, self.way)
        launch(
            clip_light, light=self.light, white=white, push=push, base=self.inverse.base, relax=RELAX,
            scaled_dual=self.light_dual, pull=self.way,
        )  # fmt: skip
        self.inverse(self.way, self.way)
        combine(1.0, self.light, self.inverse.pace, self.way, self.light)
        state.expose(self.light, self.dose)

    def _point(self) -> dict[str, Any]:
        """Where to search for limits, and the limits."""
        where = {"held": self.dose, "scaled_dual": self.dose_dual, "target": self.state.target}
        return where | {"least": self.least, "leak": self.leak, "reach": self.state.reach, "rim": RIM}


def found_levels(point: dict[str, Any], lack: float) -> tuple[float, float]:
    """a and b at which the part lacks, and voids leak, ``lack`` in all, by Newton's steps from those of the point."""
    held, target, least, leak = point["held"], point["target"], point["least"], point["leak"]

    def sought(low: float, high: float) -> tuple[float, float]:
        dose = combine(2.0, held, 1.0, point["scaled_dual"], held.device.empty(held.shape))
        return extent(dose, target, low, high, point["reach"])

    for _ in range(PASSES):
        parts = {name: parts_for(find_levels, held) for name in ("below", "shorts", "above", "over")}
        held.device.launch(find_levels, **point | {"least": least, "leak": leak}, **parts)
        found, before = sums(parts), (least, leak)
        low, high = lack - found["shorts"], found["over"] - lack
        least = min(least + low / found["below"] if found["below"] else sought(0.5, inf)[0] + lack, 1.0)
        if found["above"]:
            leak += high / found["above"]
        else:
            most = sought(-inf, 0.5)[1]
            leak = most - lack if most > -inf else 0.0
        if max(abs(low), abs(high)) <= CLOSE * lack or (least, leak) == before:
            break
    return least, leak

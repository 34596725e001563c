"""The widest window where light turns with the vial: light, its dose and the limits of both step apart."""

from __future__ import annotations

from math import ceil, inf
from typing import Any

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.errors import OutOfMemory
from vamgpu.kernels.reduce import disc
from vamgpu.kernels.split import split_dose, split_levels, split_light, split_prices
from vamgpu.methods.certificate import Bound, certified
from vamgpu.methods.method import Steps
from vamgpu.methods.state import OptimizerState
from vamgpu.operators.compose import combine
from vamgpu.operators.gram import GramInverse, against_gram
from vamgpu.operators.reductions import extent, folded, parts_for
from vamgpu.operators.scenarios import Scenarios

BACKGROUND = 0.6
"""Dose around the part that the first light aims at, over that of the part."""
LACK = 0.04
"""Dose that all voxels of the part may lack together where limits are looked for, over their number."""
RELAX = 1.6
"""How far a step goes, over where limits are met; below 2."""
CLOSE, PASSES = 1e-3, 12
"""Share of that lack which levels may be off by, and times that they are looked for at most."""
FIRST, SPACED = 8, 5
"""Steps to the second light that is judged; then a light is judged after another fifth of all steps so far."""
TOLD = 30
"""Steps from which on prices tell how wide a window can be."""
AFFORDED = 1.5
"""Evaluations of a step whose light is judged."""
VOLUMES, SINOGRAMS = 6, 7
"""Memory that it takes."""


def splits(state: OptimizerState) -> bool:
    """Whether a run can step so, and the device has the memory for it.

    Args:
        state: Of the run.
    """
    if "free" in state.memory:
        return True
    if state.piece is not None or state.brightness < inf or state.limits is not None or against_gram(state.operator):
        return False
    try:
        fields = [state.volume() for _ in range(VOLUMES)] + [state.sinogram() for _ in range(SINOGRAMS)]
    except OutOfMemory:
        return False
    del fields
    return True


def split_bound(state: OptimizerState) -> Bound | None:
    """How wide a window any light can have, as far as the prices of a run tell.

    Args:
        state: Of the run; it stays as it is.

    Returns:
        The bound, by `SWEEPS` and two evaluations that are not counted; None after fewer than 30 steps.
    """
    if state.number("made") < TOLD:
        return None
    operator, device = state.operator, state.device
    rows, columns, wall, cap = state.volume(), state.sinogram(), state.volume(), state.volume()
    operator.T(device.upload(np.ones(columns.shape, np.float32)), out=rows)
    operator(device.upload(_near(state).astype(np.float32)), out=columns)
    device.launch(split_prices, **_point(state), wall=wall, cap=cap)
    return certified(operator, state.target, state.reach, wall, cap, rows, columns, state.evaluations)


class SplitSteps:
    """One run of alternating directions: a point in the memory, and where a step leads.

    The dose of the light ``free`` is held to levels that lie as far apart as prices of one allow, apart from the light;
    light is held to 0 or more apart from both. The light that makes up for what either lacks is found at once, by the
    inverse of how projecting and exposing blur. What is dark in ``free`` may be below 0 until the end; the light that is
    judged, ``light``, has it cut off, which takes half an evaluation more.

    Args:
        state: Of the run.

    Raises:
        OutOfMemory: Where the device is too small.
    """

    state: OptimizerState

    def __init__(self, state: OptimizerState) -> None:
        self.state, self.memory = state, state.memory
        self.inverse = GramInverse(state.operator, state.reach)
        self.pull, self.step, self.dose = state.volume(), state.sinogram(), state.volume()
        scenarios = state.operator
        count = len(scenarios) if isinstance(scenarios, Scenarios) else 1
        self.lack = LACK * float(np.count_nonzero(_near(state) & (state.target.numpy() >= 0.5))) / count

    def steps(self) -> Steps:
        """The first light, then a step each."""
        memory, state = self.memory, self.state
        if "free" not in memory:
            self._begin()
        while not memory["made"] or state.affords(AFFORDED):
            self._step()
            memory["made"] += 1.0
            if memory["made"] >= state.number("judged next") or self._is_last():
                self._judge()
            yield 1.0 - state.best.window, state.number("seen")

    # ---- a run -----------------------------------------------------------------------------------------------
    def _begin(self) -> None:
        """Light that undoes the blur of the target, or that of before, with nothing owed."""
        state, memory = self.state, self.memory
        free = state.sinogram()
        if "light" in memory:
            state.scale(1.0, state.buffer("light"), free)
        else:
            state.fill_background(BACKGROUND, self.pull)
            state.project(self.pull, self.step)
            self.inverse(self.step, free)
        held = state.volume()
        state.expose(free, held)
        if "light" in memory:
            greatest = max(extent(held)[1], 1e-30)
            for field in (free, held):
                state.scale(1.0 / greatest, field, field)
        memory |= {"free": free, "held": held, "light": state.sinogram(), "made": 0.0, "judged next": 1.0}
        memory |= {"dose owed": combine(-1.0, held, 0.0, held, state.volume())}
        memory |= {"light owed": combine(-1.0, free, 0.0, free, state.sinogram())}
        memory |= {"least": 1.0, "leak": BACKGROUND}

    def _step(self) -> None:
        state, memory, launch = self.state, self.memory, self.state.device.launch
        self._find_levels()
        launch(split_dose, **_point(state), relax=RELAX, pull=self.pull)
        state.project(self.pull, self.step)
        free = state.buffer("free")
        launch(split_light, light=free, base=self.inverse.base, relax=RELAX, owed=memory["light owed"], pull=self.step)
        self.inverse(self.step, self.step)
        state.combine(1.0, free, 1.0, self.step, free)
        state.expose(free, state.buffer("held"))

    def _find_levels(self) -> None:
        """Levels at which the part lacks, and voids leak, as much as they may together: Newton's steps from the last."""
        state, memory = self.state, self.memory
        held = state.buffer("held")
        for _ in range(PASSES):
            parts = {name: parts_for(split_levels, held) for name in ("below", "shorts", "above", "over")}
            state.device.launch(split_levels, **_point(state), **parts)
            found = {name: folded(each) for name, each in parts.items()}
            low, high = self.lack - found["shorts"], found["over"] - self.lack
            if found["below"]:
                memory["least"] = min(memory["least"] + low / found["below"], 1.0)
            else:
                memory["least"] = min(extent(self._looked_for(), state.target, 0.5, inf, state.reach)[0] + self.lack, 1.0)
            if found["above"]:
                memory["leak"] += high / found["above"]
            else:
                most = extent(self._looked_for(), state.target, -inf, 0.5, state.reach)[1]
                memory["leak"] = most - self.lack if most > -inf else 0.0
            if max(abs(low), abs(high)) <= CLOSE * self.lack:
                return

    def _judge(self) -> None:
        """Judge the light without what is below 0."""
        state, memory = self.state, self.memory
        light = state.buffer("light")
        combine(1.0, state.buffer("free"), 0.0, state.buffer("free"), light, floor=0.0)
        state.expose(light, self.dose)
        memory["seen"] = state.window(self.dose)[0]
        state.best.offer(light, 1.0 - memory["seen"], memory["seen"], state.iteration + 1)
        memory["judged next"] = max(memory["made"] + ceil(memory["made"] / SPACED), float(FIRST))

    def _is_last(self) -> bool:
        """Whether the run may not make another step and judge its light too."""
        state, cost = self.state, getattr(self.state.operator, "cost", 1.0)
        return not state.affords(AFFORDED) or (state.iteration + 1) * cost >= state.budget

    def _looked_for(self) -> DeviceArray:
        return combine(2.0, self.memory["held"], 1.0, self.memory["dose owed"], self.pull)


def _point(state: OptimizerState) -> dict[str, Any]:
    """Where limits are looked for, and at which levels."""
    memory = state.memory
    return {
        "held": memory["held"], "owed": memory["dose owed"], "target": state.target, "least": memory["least"],
        "leak": memory["leak"], "reach": state.reach,
    }  # fmt: skip


def _near(state: OptimizerState) -> np.ndarray:
    """Which voxels count."""
    shape = state.target.shape
    return np.broadcast_to(disc(shape[0], shape[1], state.reach)[:, :, None], shape)

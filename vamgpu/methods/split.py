"""The widest window where light turns with the vial: light, its dose and the limits of both step apart."""

from __future__ import annotations

from collections.abc import Callable
from math import ceil, inf, sqrt
from typing import Any

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.errors import BadInput, OutOfMemory
from vamgpu.kernels.split import split_dose, split_levels, split_light, split_prices
from vamgpu.losses.band import Band
from vamgpu.methods.certificate import Bound, certified
from vamgpu.methods.method import Steps
from vamgpu.methods.state import OptimizerState
from vamgpu.operators.compose import capped, combine
from vamgpu.operators.gram import RIM, GramInverse, against_gram
from vamgpu.operators.reductions import extent, folded, parts_for
from vamgpu.operators.scenarios import Scenarios

BACKGROUND = 0.6
"""Dose around the part that the first light aims at, over that of the part."""
LACK = 0.04
"""Dose that all voxels of the part may lack together where limits are looked for, over their number; of scenarios,
whose voxels stand for each other, over its root."""
RELAX = 1.6
"""How far a step goes, over where limits are met; below 2."""
CLOSE, PASSES = 1e-3, 12
"""Share of that lack which levels may be off by, and times that they are looked for at most."""
FIRST, SPACED = 8, 5
"""Steps to the second light that is judged; then a light is judged after another fifth of all steps so far."""
UNLIMITED = 3e38
MARGINS, AGREED = (0.01, 0.002), 0.4
"""Share of the brightness allowed that is left out, at first and at last; steps times it in between."""
TOLD = 30
"""Steps from which on prices tell how wide a window can be."""
UNSEEN = Band.thresholds(0.78, 0.95)
"""Stands for the loss of the last light, which is chosen by its window."""
VOLUMES, SINOGRAMS = 8, 11
"""Memory that it takes."""


def split_steps(state: OptimizerState, rim: float = RIM) -> SplitSteps | None:
    """The steps of a run, where the light of one pose turns and the device has the memory for them.

    Args:
        state: Of the run.
        rim: What voxels beyond the judged cylinder count of the others.

    Returns:
        The steps; None where a run cannot take them.

    Raises:
        BadInput: A run that stepped so goes on with an operator or a target for which it cannot.
        OutOfMemory: It goes on where the device is too small.
    """
    why = "light is decided in part" if state.piece is not None else against_gram(state.operator)
    why = "voxels have limits of their own" if state.limits is not None else why
    if "free" in state.memory and why:
        raise BadInput(f"the plan to resume cannot go on here: {why}; give its light as start")
    begun = "free" in state.memory
    if why or not (begun or state.has_room(VOLUMES, SINOGRAMS)):
        return None
    try:
        return SplitSteps(state, rim)
    except OutOfMemory:
        if begun:
            raise
        return None


def split_bound(state: OptimizerState) -> Bound | None:
    """How wide a window any light can have, as far as the prices of a run tell.

    Args:
        state: Of the run; it stays as it is.

    Returns:
        The bound, by `SWEEPS` and two evaluations that are not counted; None after fewer than 30 steps, and where the
        device lacks the memory.
    """
    try:
        return _bound(state) if state.number("made") >= TOLD else None
    except OutOfMemory:
        return None


def _bound(state: OptimizerState) -> Bound:
    operator, device = state.operator, state.device
    rows, columns, wall, cap = state.volume(), state.sinogram(), state.volume(), state.volume()
    operator.T(device.upload(np.ones(columns.shape, np.float32)), out=rows)
    operator(device.upload(state.near()), out=columns)
    point = {**_point(state), "rim": 0.0}  # no price where nobody judges
    device.launch(split_prices, **point, wall=wall, cap=cap)
    return certified(operator, state.target, state.reach, wall, cap, rows, columns, state.evaluations + 1.0)


class SplitSteps:
    """One run of alternating directions: a point in the memory, and where a step leads.

    The dose of the light ``free`` is held to levels as far apart as prices of one allow, and light to 0 or more, each
    apart from the other. The light that makes up for what both lack is found at once, by the inverse of how projecting
    and exposing blur. Pixels of ``free`` may be below 0 until the end; the light that is judged, ``light``, has that
    cut off, for half an evaluation more. That of the last light is not counted, as of other methods. A greatest light
    moves with the dose at the threshold, and what a higher dose is worth raises both levels.

    Args:
        state: Of the run.
        rim: What voxels beyond the judged cylinder count of the others.

    Raises:
        OutOfMemory: Where the device is too small.
    """

    state: OptimizerState
    memory: dict[str, Any]
    inverse: GramInverse
    pull: DeviceArray
    way: DeviceArray
    dose: DeviceArray
    lack: float

    def __init__(self, state: OptimizerState, rim: float = RIM) -> None:
        self.state, self.memory = state, state.memory
        self.memory["rim"] = rim
        self.inverse = GramInverse(state.operator, state.reach, rim)
        self.pull, self.way, self.dose = state.volume(), state.sinogram(), state.volume()
        scenarios = state.operator
        count = len(scenarios) if isinstance(scenarios, Scenarios) else 1
        self.lack = LACK * float(np.count_nonzero(state.near() * state.target.numpy() >= 0.5)) / sqrt(count)

    def steps(self) -> Steps:
        """The first light, then a step each, as many as evaluations allow."""
        memory, state = self.memory, self.state
        if "free" not in memory:
            self.begin()
        light = state.buffer("light")
        while not memory["made"] or state.affords(1.0):
            self.step()
            memory["made"] += 1.0
            combine(1.0, memory["free"], 0.0, memory["free"], light, floor=0.0)
            if state.brightness < inf:
                capped(light, self._most())
            else:
                state.best.unseen = UNSEEN
            if memory["made"] >= memory["judged next"] or (state.brightness < inf and not state.affords(1.5)):
                self._judge(light)
            yield 1.0 - state.best.window, memory["seen"]

    # ---- a run -----------------------------------------------------------------------------------------------
    def begin(self) -> None:
        """Light that undoes the blur of the target, or that of before, with nothing owed."""
        state, memory = self.state, self.memory
        free, started = state.sinogram(), "light" in memory
        if started:
            state.scale(1.0, state.buffer("light"), free)
        else:
            state.fill_background(BACKGROUND, self.pull)
            self._project()
            self.inverse(self.way, free)
        held = state.volume()
        state.expose(free, held)
        if started:
            greatest = max(extent(held)[1], 1e-30)
            for field in (free, held):
                state.scale(1.0 / greatest, field, field)
        if state.brightness < inf:
            state.best.forget()  # the light to begin with may be too bright
        memory |= {"free": free, "held": held, "light": state.sinogram(), "made": 0.0, "judged next": 1.0}
        memory |= {"dose owed": combine(-1.0, held, 0.0, held, state.volume())}
        memory |= {"light owed": combine(-1.0, free, 0.0, free, state.sinogram())}
        memory |= {"least": 1.0, "leak": BACKGROUND}
        if state.brightness < inf and started:
            self._offer(free, held, 0)

    def step(self, hold: Callable[..., None] | None = None) -> None:
        """Step once.

        Args:
            hold: Holds light to limits in place of 0 or more: launches a kernel like `split_light`, given light, base,
                relax, owed and pull.
        """
        state, memory, launch = self.state, self.memory, self.state.device.launch
        self._find_levels()
        launch(split_dose, **_point(state), relax=RELAX, pull=self.pull)
        self._project()
        free = state.buffer("free")
        (hold or self._hold)(light=free, base=self.inverse.base, relax=RELAX, owed=memory["light owed"], pull=self.way)
        self.inverse(self.way, self.way)
        state.combine(1.0, free, 1.0, self.way, free)
        state.expose(free, state.buffer("held"))

    def _hold(self, **step: Any) -> None:
        """Hold light to 0 or more, and to its greatest, of which the worth is told."""
        state, over = self.state, parts_for(split_light, self.way)
        state.device.launch(split_light, **step, most=self._most(), over=over)
        if state.brightness < inf:
            self.memory["raised"] = 0.5 * self._kept_to() * state.brightness * self.inverse.base * folded(over)

    def _project(self) -> None:
        """What is pulled, as light is to move.

        Rows beside the volume move as far as others for a bound alone: they would get bright, and nobody holds the
        resin dark that they light above and below. Where light has a greatest, rows count alike, for prices of it do.
        """
        self.state.project(self.pull, self.way)
        if self.memory["rim"] == 0.0 and self.state.brightness == inf:
            self.inverse.weigh_rows(self.way)

    def _find_levels(self) -> None:
        """Levels at which the part lacks, and voids leak, as much as they may together: Newton's steps from the last.

        A dose at the threshold that is higher allows brighter light: what that is worth raises both levels.
        """
        state, memory = self.state, self.memory
        held, raised = state.buffer("held"), state.number("raised")
        for _ in range(PASSES):
            parts = {name: parts_for(split_levels, held) for name in ("below", "shorts", "above", "over")}
            state.device.launch(split_levels, **_point(state), **parts)
            found = {name: folded(each) for name, each in parts.items()}
            low, high = self.lack + raised - found["shorts"], found["over"] - max(self.lack - raised, 0.0)
            if found["below"]:
                memory["least"] = min(memory["least"] + low / found["below"], 1.0)
            else:
                memory["least"] = min(extent(self._looked_for(), state.target, 0.5, inf)[0] + self.lack, 1.0)
            if found["above"]:
                memory["leak"] += high / found["above"]
            else:
                most = extent(self._looked_for(), state.target, -inf, 0.5)[1]
                memory["leak"] = most - self.lack if most > -inf else 0.0
            if max(abs(low), abs(high)) <= CLOSE * self.lack:
                return

    def _judge(self, light: DeviceArray) -> None:
        """Find the window of the light without what is below 0, where the run can pay for it."""
        state, memory = self.state, self.memory
        memory["judged next"] = max(memory["made"] + ceil(memory["made"] / SPACED), float(FIRST))
        if memory["made"] > 1.0 and not state.affords(0.5):
            return
        state.expose(light, self.dose)
        self._offer(light, self.dose, 1)

    def _offer(self, light: DeviceArray, dose: DeviceArray, made: int) -> None:
        """Offer light by its dose, any that is too bright behind all that is not."""
        state = self.state
        window = kept = state.window(dose)[0]
        if state.brightness < inf:
            least, leak, _ = state.extremes(dose)
            over = extent(light)[1] / max(state.brightness * 0.5 * (least + max(leak, 0.0)), 1e-30)
            kept = window if over <= 1.0 else -1.0 - min(over, 1e9)
            kept = kept if window > -1.0 else -2e9  # dark light is no light
        self.memory["seen"] = window
        state.best.offer(light, 1.0 - kept, kept, state.iteration + made)

    def _most(self) -> float:
        """Greatest light of a pixel, by the dose at the threshold that levels have."""
        middle = max(0.5 * (self.memory["least"] + max(self.memory["leak"], 0.0)), 1e-6)
        return min(self._kept_to() * self.state.brightness * middle, UNLIMITED)

    def _kept_to(self) -> float:
        """Share of the brightness allowed that light keeps to: more of it as levels and doses agree."""
        return 1.0 - min(MARGINS[0], max(MARGINS[1], AGREED / max(self.memory["made"], 1.0)))

    def _looked_for(self) -> DeviceArray:
        return combine(2.0, self.memory["held"], 1.0, self.memory["dose owed"], self.pull)


def _point(state: OptimizerState) -> dict[str, Any]:
    """Where limits are looked for, and at which levels."""
    memory = state.memory
    return {
        "held": memory["held"], "owed": memory["dose owed"], "target": state.target, "least": memory["least"],
        "leak": memory["leak"], "reach": state.reach, "rim": memory["rim"],
    }  # fmt: skip

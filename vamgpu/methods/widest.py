"""The widest process window there is: light, and the prices of its limits, step towards each other."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf, sqrt
from typing import Any, ClassVar

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.errors import BadInput
from vamgpu.kernels.dwell import weigh_poses
from vamgpu.kernels.saddle import light_step, limit_step, price_dose, reflect
from vamgpu.kernels.update import multiply
from vamgpu.methods.active import ActiveScenarios
from vamgpu.methods.certificate import Bound, certified
from vamgpu.methods.graylimits import GrayLimits
from vamgpu.methods.limit import MARGIN
from vamgpu.methods.method import Criterion, Method, Steps
from vamgpu.methods.papers import ANCHORED, DIAGONAL, PRIMAL_DUAL, SAFE_STEPS, SPLITTING
from vamgpu.methods.recipe import Recipe
from vamgpu.methods.split import split_bound, split_steps
from vamgpu.methods.state import OptimizerState
from vamgpu.operators.compose import capped, combine
from vamgpu.operators.gram import RIM
from vamgpu.operators.reductions import dot, extent, folded, parts_for, total

MEAN_ROW = 2.0
"""Dose of light 1 everywhere, mean over the voxels that count, in the unit that steps are measured in."""
ACTIVE = 0.3
"""Share of the part's voxels that are expected to hold the window."""
LEVELS: tuple[str, ...] = ("least", "leak", "inside", "outside")
"""Dose that the part has at least, dose that voids have at most, and how much all prices of either come to."""
FIELDS = ("light", "wall", "cap", "held")
"""Light, prices of limits (`limit_step`), and the dose of the light."""
SIDES = (("least", "inside", 1.0), ("leak", "outside", -1.0))
"""Each dose with the prices that hold it, and whether it is to rise or to fall."""
SOON, LATE, LONGEST = 0.1, 0.4, 250
"""A round ends at this share of its first gap; at that share once the gap grows; after so many steps."""

UNLIMITED = 3e38
NEAR, FIRST_WAY, SHORTER = 0.9, 0.04, 40
"""Share of the brightness that may be, from which on it is minded; then the share by which the dose at the threshold
is moved after a round, and the longest round."""
DIMMED = 8
"""Times that the first light is cut to what it may be."""
TOLD = 60
"""Steps from which on prices tell how wide a window can be."""


@dataclass(frozen=True)
class WidestWindow(Method):
    """Maximize the strict process window itself; an iteration is one projector evaluation, or half of one more.

    Where the light of one pose turns (even angles over a full turn, in air or a vessel at rest, a part without bodies),
    `SplitSteps` find it: light that makes up for what doses lack comes at once, by the inverse of how projecting and
    exposing blur. Making the inverse projects two slices ten times or more, which is not counted; windows between the
    lights that are judged are those of the last. Elsewhere steps are primal-dual: every voxel prices its limit, a dose
    of the part at least, one of voids at most, and 1 at most. Light follows the prices, and prices follow the dose.
    Each pixel and voxel has a step of its own; steps grow as far as they prove safe, go beyond where they lead, and are
    held back by where their round began. There is nothing to choose. Takes twelve volumes and eleven sinograms of
    memory at most.

    A gray dose has two limits: it keeps half of the window from both ends of its tolerance about the dose midway
    between the part's least and its greatest. The window is then twice what all doses may be off by.

    Args:
        passes: Passes of the recipe that come before primal-dual steps.
        rim: What voxels beyond the judged cylinder count of the others where light turns: they are to stay as dark as
            voids. 0 leaves them free, as `bound` does, which tells what is judged.

    Raises:
        BadInput: A value is out of its range.
    """

    passes: int = 2
    rim: float = RIM
    papers: ClassVar[tuple[str, ...]] = (SPLITTING, PRIMAL_DUAL, DIAGONAL, ANCHORED, SAFE_STEPS)
    iterations: ClassVar[int] = 400
    cost: ClassVar[float] = 1.0
    criterion: ClassVar[Criterion] = "window"
    takes_start: ClassVar[bool] = True
    takes_weights: ClassVar[bool] = False
    takes_gray: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if isinstance(self.passes, bool) or not isinstance(self.passes, int) or self.passes < 1:
            raise BadInput(f"passes is {self.passes!r}; expected a whole number ≥ 1")
        if isinstance(self.rim, bool) or not isinstance(self.rim, (int, float)) or not 0.0 <= self.rim <= 1.0:
            raise BadInput(f"rim is {self.rim!r}; expected a share from 0 to 1")

    def steps(self, state: OptimizerState) -> Steps:
        split = None if "rows" in state.memory else split_steps(state, self.rim)
        if split is not None:
            yield from split.steps()
            return
        if state.piece is None:
            yield from Recipe().first(state, self.passes)
        yield from _Saddle(state).steps()

    def certify(self, state: OptimizerState) -> Bound | None:
        """How wide a window any light can have, as far as the prices of a run tell.

        Args:
            state: Of the run; it stays as it is.

        Returns:
            The bound, by `SWEEPS` and two evaluations that are not counted; None after fewer than 60 primal-dual
            steps, or 30 of the others.
        """
        if "free" in state.memory:
            return split_bound(state)
        return _Saddle(state).bound() if state.number("made") >= TOLD else None


class _Saddle:
    """One run: a point and its anchor in ``memory``, by the names of `FIELDS` and `LEVELS`; where a step leads."""

    def __init__(self, state: OptimizerState) -> None:
        self.state, self.memory = state, state.memory
        self.after = {name: self._empty(name) for name in FIELDS}
        self.levels = dict.fromkeys(LEVELS, 0.0)
        self.pull, self.descent = state.volume(), state.sinogram()
        self.active = ActiveScenarios(state)
        self.gray: GrayLimits | None = None
        if state.limits is not None and state.limits.gray.any() and state.piece is None:
            self.gray = GrayLimits(state.target, state.limits, state.reach)
            self.active.scenarios = None  # one that rests has no dose that lies between all limits
        self.classes = state.target if self.gray is None else self.gray.classes

    def steps(self) -> Steps:
        """Lengths of steps and the dose to begin with, then one primal-dual step each."""
        state, memory = self.state, self.memory
        if "rows" not in memory:
            found = self._begin()
            if state.piece is not None or state.brightness < inf:
                found = self._offer(memory)
            yield 1.0 - state.best.window, found
        found = state.best.window
        while True:
            gap = self._step()
            other = self.active.due and self.active.look(self.after)
            if not self.active.any_rest or self.active.due:
                found = self._offer(self.after)
            turn, first = state.number("turn"), state.number("first") or gap
            near = gap <= SOON * first or (gap <= LATE * first and gap > state.number("last", inf))
            memory |= {"turn": turn + 1.0, "first": first, "last": gap}
            if other:
                self._measure()
                self._anchor(self.after, self.levels)
            elif turn and (near or turn > (SHORTER if "middle" in memory else LONGEST)):
                self._balance()
                if "middle" in memory:
                    self._move_middle()
                self._anchor(self.after, self.levels)
            else:
                self._reflect((turn + 1.0) / (turn + 2.0))
            yield 1.0 - state.best.window, found

    def _offer(self, fields: Mapping[str, Any]) -> float:
        """Offer light by its dose; returns its window, and keeps what is too bright behind all that is not."""
        state, light = self.state, fields["light"]
        found = self._window(fields["held"])
        kept = found
        if state.brightness < inf:
            least, leak, _ = state.extremes(fields["held"])
            over = extent(light)[1] / max(state.brightness * 0.5 * (least + max(leak, 0.0)), 1e-30)
            kept = found if over <= 1.0 else -1.0 - min(over, 1e9)
            if over > NEAR and "middle" not in self.memory:
                self.memory["middle"] = 0.5 * (least + max(leak, 0.0))
            self.memory["round best"] = max(state.number("round best", -inf), kept)
        state.best.offer(light, 1.0 - kept, kept, state.iteration + 1)
        return found

    def _window(self, held: DeviceArray) -> float:
        """Strict window of a dose, the limits of gray bodies included."""
        state = self.state
        if self.gray is None:
            return state.window(held)[0]
        least, leak, greatest = state.extremes(held)
        return self.gray.window(held, least, leak, greatest)

    def _most(self) -> float:
        """Greatest light of a pixel, by the dose at the threshold that levels keep to."""
        return min(MARGIN * self.state.brightness * self.state.number("middle", inf), UNLIMITED)

    def _move_middle(self) -> None:
        """Look for the dose at the threshold that leaves the widest window: more of it allows brighter light."""
        memory, number = self.memory, self.state.number
        found, before, way = number("round best", -inf), number("round before", -inf), number("way", FIRST_WAY)
        if found < -1.0:
            way = -FIRST_WAY
        elif found < before:
            way *= -0.5
        memory |= {"middle": min(number("middle") * (1.0 + way), 1.0), "way": way, "round before": found}
        memory.pop("round best", None)

    def bound(self) -> Bound:
        """That of the prices where a step leads; the memory stays as it is."""
        state, memory, after = self.state, self.memory, self.after
        kept = {name: memory[name] for name in ("length", "made", "evaluations")}
        self._step()
        spent = state.evaluations
        memory |= kept
        state.evaluations = state.number("evaluations")
        with self.active.awake():
            return certified(
                state.operator, state.target, state.reach, after["wall"], after["cap"], memory["rows"],
                memory["columns"], spent, self.gray and self.gray.owed(after["wall"], after["cap"], memory["loose"]),
            )  # fmt: skip

    def _empty(self, name: str) -> DeviceArray:
        return self.state.sinogram() if name == "light" else self.state.volume()

    # ---- a round ---------------------------------------------------------------------------------------------
    def _begin(self) -> float:
        """The light of before, scaled to a dose of 1 at most, with the prices owed; lengths of steps. Its window."""
        state, memory, upload = self.state, self.memory, self.state.device.upload
        light = state.buffer("light")
        for name in ("rows", "columns", "held"):
            memory[name] = self._empty("light" if name == "columns" else name)
        rows, held = memory["rows"], memory["held"]
        even = self._free(upload(np.ones(light.shape, np.float32)))
        state.operator.T(even, out=rows)  # what every method spends
        if state.piece is not None:
            state.device.launch(multiply, x=rows, y=upload(state.near()), out=rows)
        state.expose(light, held)
        found, greatest = state.window(held)
        if self.gray is not None:
            found = self._window(held)
        owed = memory.pop("owed", None)
        if owed is None:
            self.active.begin(held)
        near = state.near()
        unit = MEAN_ROW * float(np.count_nonzero(near)) / max(dot(rows, upload(near)), 1e-30)
        state.scale(unit, rows, rows)
        memory["unit"] = unit
        self._measure()
        for field in (light, held) if state.piece is None else ():
            state.scale(1.0 / greatest, field, field)
        for name in ("wall", "cap"):
            memory[name] = upload(np.zeros(held.shape, np.float32))
        if owed is not None:
            memory["wall"] = owed
        if state.brightness < inf:
            state.best.forget()
            self._dim(light, held)
        least, leak, _ = state.extremes(held)
        sums = (0.0, 0.0) if owed is None else (1.0, 1.0)
        memory |= dict(zip(LEVELS, (least, max(leak, 0.0), *sums), strict=True))
        prices = 2.0 * (MEAN_ROW + 1.0) / (ACTIVE * max(memory["inside voxels"], 1.0))
        far = max(dot(light, light) * self._mean_column(), 1e-30)
        memory |= {"length": 1.0, "weight": sqrt(prices / far), "made": 0.0}
        self._anchor(memory, memory)
        return found

    def _dim(self, light: DeviceArray, held: DeviceArray) -> None:
        """Cut the brightest pixels off until the light lasts no longer than it may; a few times, as the dose falls."""
        for _ in range(DIMMED):
            least, leak, greatest = self.state.extremes(held)
            most = MARGIN * self.state.brightness * 0.5 * (least + max(leak, 0.0))
            if extent(light)[1] <= most:
                return
            self.memory["middle"] = 0.5 * (least + max(leak, 0.0))
            capped(light, most)
            self.state.expose(light, held)
            greatest = self.state.extremes(held)[2]
            for field in (light, held):
                self.state.scale(1.0 / max(greatest, 1e-30), field, field)

    def _measure(self) -> None:
        """How many limits there are, and what a pixel adds to them all, scenarios that rest left out."""
        state, memory = self.state, self.memory
        counted = self.active.counted(_counted(state))
        inside, outside = (float(np.count_nonzero(counted == limits)) for limits in (2.0, 1.0))
        both = 0.0 if self.gray is None else self.gray.voxels
        memory |= {"inside voxels": inside, "outside voxels": outside + both}
        state.project(state.device.upload(counted), memory["columns"])
        self._free(memory["columns"])
        state.scale(1.0 / memory["unit"], memory["columns"], memory["columns"])

    def _free(self, light: DeviceArray) -> DeviceArray:
        """Light of which nothing is left at poses that are decided."""
        if self.state.piece is not None:
            self.state.device.launch(weigh_poses, light=light, times=self.state.piece.free, weighted=light)
        return light

    def _mean_column(self) -> float:
        columns = self.memory["columns"]
        return dot(columns, columns) / max(total(columns), 1e-30)

    def _anchor(self, fields: Mapping[str, Any], levels: Mapping[str, float]) -> None:
        """Begin a round at a point."""
        for name in FIELDS:
            for place in (name, f"{name} anchor"):
                if place not in self.memory:
                    self.memory[place] = self._empty(name)
                if self.memory[place] is not fields[name]:
                    self.state.scale(1.0, fields[name], self.memory[place])
        for name in LEVELS:
            self.memory[name] = self.memory[f"{name} anchor"] = levels[name]
        self.memory |= {"turn": 0.0, "first": 0.0, "last": inf}
        if self.gray is not None:
            self.memory["loose"] = GrayLimits.loose(levels["least"], levels["leak"])

    def _reflect(self, share: float) -> None:
        """Go beyond where the step leads, held back by the anchor."""
        memory = self.memory
        for name in FIELDS:
            now, anchor = memory[name], memory[f"{name} anchor"]
            self.state.device.launch(reflect, step=self.after[name], anchor=anchor, share=share, now=now)
        for name in LEVELS:
            beyond = 2.0 * self.levels[name] - memory[name]
            memory[name] = share * beyond + (1.0 - share) * memory[f"{name} anchor"]

    def _balance(self) -> None:
        """Weigh light against prices by how far either went in the round."""
        way = {name: self._apart(name) for name in FIELDS[:3]}
        light = way["light"] * self._mean_column()
        prices = (MEAN_ROW + 1.0) * way["wall"] + MEAN_ROW * way["cap"]
        if light > 0.0 and prices > 0.0:
            self.memory["weight"] = (prices / light) ** 0.15 * self.memory["weight"] ** 0.7

    def _apart(self, name: str) -> float:
        """Square of the way from the anchor."""
        way = combine(1.0, self.after[name], -1.0, self.memory[f"{name} anchor"], self.memory[name])
        return dot(way, way)

    # ---- a step ----------------------------------------------------------------------------------------------
    def _step(self) -> float:
        """Find where a step leads from the point; returns how far that is, and sets the length of the next one."""
        state, memory, launch, levels = self.state, self.memory, self.state.device.launch, self.levels
        length, weight, after = memory["length"], memory["weight"], self.after
        launch(price_dose, wall=memory["wall"], cap=memory["cap"], target=state.target, pull=self.pull)
        state.project(self.pull, self.descent)
        moved = parts_for(light_step, self.descent)
        launch(
            light_step, light=memory["light"], columns=memory["columns"], step=length / weight, most=self._most(),
            ahead=self.descent, after=after["light"], moved=moved,
        )  # fmt: skip
        gap, paces = weight / length * folded(moved), {}
        for level, side, sign in SIDES:
            voxels = memory[f"{side} voxels"]
            pace = 0.5 * length / (weight * max(voxels, 1.0))
            way = sign * pace * (1.0 - memory[side]) * (voxels > 0)
            levels[level] = memory[level] + way
            if state.piece is not None and state.piece.levels is not None:
                enough = dict(zip(LEVELS, state.piece.levels, strict=False))[level]
                levels[level] = sign * min(sign * levels[level], sign * enough)
            paces[level] = pace
        if "middle" in memory:
            short = max(0.0, 2.0 * memory["middle"] - levels["least"] - levels["leak"]) / sum(paces.values())
            levels |= {level: levels[level] + short * pace for level, pace in paces.items()}
        gap += sum((levels[level] - memory[level]) ** 2 / pace for level, pace in paces.items())
        state.expose(self.descent, after["held"])
        parts = {name: parts_for(limit_step, self.pull) for name in ("inside", "outside", "moved", "crossed")}
        launch(
            limit_step, ahead=after["held"], held=memory["held"], target=self.classes, rows=memory["rows"],
            least=2.0 * levels["least"] - memory["least"], leak=2.0 * levels["leak"] - memory["leak"],
            loose=state.number("loose"),
            step=length * weight, reach=state.reach, wall=memory["wall"], cap=memory["cap"],
            wall_after=after["wall"], cap_after=after["cap"], **parts,
        )  # fmt: skip
        found = {name: folded(each) for name, each in parts.items()}
        levels |= {"inside": found["inside"], "outside": found["outside"]}
        combine(0.5, after["held"], 0.5, memory["held"], after["held"])
        gap += found["moved"] / (length * weight)
        crossed = found["crossed"] + sum(
            sign * (levels[level] - memory[level]) * (levels[side] - memory[side]) for level, side, sign in SIDES
        )
        self._lengthen(gap / max(2.0 * abs(crossed), 1e-30))
        return sqrt(gap)

    def _lengthen(self, safe: float) -> None:
        """A longer step, as far as this one was safe: ``safe`` times as long would have been so."""
        made = self.memory["made"] = self.state.number("made") + 1.0
        most = min((1.0 - (made + 1.0) ** -0.3) * safe, 1.0 + (made + 1.0) ** -0.6)
        self.memory["length"] = max(0.8, most * self.memory["length"])


def _counted(state: OptimizerState) -> np.ndarray:
    """How many limits a voxel's dose has: 2 in the part, 1 outside, 0 beyond the cylinder that counts."""
    return state.near() * (1.0 + (state.target.numpy() >= 0.5)).astype(np.float32)

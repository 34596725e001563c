"""The window's linear program, solved by PDHG; its multipliers bound the strict window of any light.

    maximize a − b   over g ≥ 0, a, b   subject to   a ≤ (Aᵀg)ᵢ ≤ 1 in the part,   (Aᵀg)ᵢ ≤ b outside

With multipliers y ≥ 0 of the limits Kx ≤ c of x = (g, a, b), a step is (`PDHG.papers`)
    x⁺ = proj(x − τ (Kᵀy − (0, 1, −1)))        y⁺ = max(0, y + σ (K(2x⁺ − x) − c))
for each pixel and voxel, and rounds of k steps are reflected and anchored (H. Lu, J. Yang, arXiv:2407.16144):
z ← (k + 1)/(k + 2)·(2z⁺ − z) + z₀/(k + 2).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf, sqrt
from typing import Any, ClassVar

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.kernels.dwell import weigh_poses
from vamgpu.kernels.pdhg import dual_dose, dual_step, primal_step
from vamgpu.kernels.update import multiply
from vamgpu.methods.certificate import Bound, certified, limited
from vamgpu.methods.fbp import filtered_light
from vamgpu.methods.method import Criterion, Method, Steps
from vamgpu.methods.papers import ANCHORED, DIAGONAL, PRIMAL_DUAL, SAFE_STEPS
from vamgpu.methods.state import UNLIMITED, OptimizerState
from vamgpu.operators.compose import combine
from vamgpu.operators.reductions import dot, parts_for, sums, total

MEAN_ROW = 2.0  # dose of light 1 everywhere, averaged over the voxels that count; the unit of the steps
ACTIVE = 0.3  # share of the part's voxels that are expected to limit the window
LEVELS: tuple[str, ...] = ("least", "leak", "inside", "outside")  # a, b, and the sums of the multipliers of each
FIELDS = ("light", "lower", "upper", "held")  # g, the multipliers of `dual_step`, and Aᵀg
SIDES = (("least", "inside", 1.0), ("leak", "outside", -1.0))
"""Each level with its multipliers, and whether it should rise or fall."""
SOON, LATE, LONGEST = 0.1, 0.4, 250
"""A round ends at the first share of its initial gap, at the second if the gap grows, or after this many steps."""
LENGTHS = (0.8, 2.0)  # factor by which steps are longer than is provably safe; longer ones oscillate
TOLD = 60  # number of steps after which the multipliers bound the window usefully


@dataclass(frozen=True)
class PDHG(Method):
    """Solve the window's linear program; an iteration is one projector evaluation."""

    papers: ClassVar[tuple[str, ...]] = (PRIMAL_DUAL, DIAGONAL, ANCHORED, SAFE_STEPS)
    iterations: ClassVar[int] = 400
    criterion: ClassVar[Criterion] = "window"
    takes_start: ClassVar[bool] = True
    takes_weights: ClassVar[bool] = False

    def steps(self, state: OptimizerState) -> Steps:
        if "light" not in state.memory:
            filtered_light(state, state.volume())
        yield from _Run(state).steps()

    def certify(self, state: OptimizerState) -> Bound | None:
        """The bound from the multipliers of a run, by `SWEEPS` and two evaluations; None after few steps."""
        return _Run(state).bound() if state.number("made") >= TOLD else None


class _Run:
    """One run: a point and its anchor in ``memory``, by the names of `FIELDS` and `LEVELS`; and the next point."""

    def __init__(self, state: OptimizerState) -> None:
        self.state, self.memory = state, state.memory
        self.after = {name: self._empty(name) for name in FIELDS}
        self.levels = dict.fromkeys(LEVELS, 0.0)
        self.pull, self.descent = state.volume(), state.sinogram()

    def steps(self) -> Steps:
        """Lengths of steps and the initial dose, then one primal-dual step each."""
        state, memory = self.state, self.memory
        if "rows" not in memory:
            self._begin()
            window = self._offer(memory)
            yield 1.0 - state.best.window, window
        while True:
            gap = self._step()
            window = self._offer(self.after)
            turn, first = state.number("turn"), state.number("first") or gap
            near = gap <= SOON * first or (gap <= LATE * first and gap > state.number("last", inf))
            memory |= {"turn": turn + 1.0, "first": first, "last": gap}
            if turn and (near or turn > LONGEST):
                self._balance()
                self._anchor(self.after, self.levels)
            else:
                self._reflect((turn + 1.0) / (turn + 2.0))
            yield 1.0 - state.best.window, window

    def _offer(self, fields: Mapping[str, Any]) -> float:
        """Offer light by its dose; returns its window."""
        state = self.state
        window = state.window(fields["held"])[0]
        state.best.offer(fields["light"], 1.0 - window, window, state.iteration + 1)
        return window

    def bound(self) -> Bound:
        """The bound from the multipliers of the next point; the memory does not change."""
        state, memory, after = self.state, self.memory, self.after
        kept = {name: memory[name] for name in ("length", "made", "evaluations")}
        self._step()
        spent = state.evaluations
        memory |= kept
        state.evaluations = state.number("evaluations")
        if state.most < inf:
            return limited(state.operator, state.target, after["lower"], after["upper"], state.most, spent)
        return certified(
            state.operator, state.target, state.reach, after["lower"], after["upper"], memory["rows"],
            memory["columns"], spent,
        )  # fmt: skip

    def _empty(self, name: str) -> DeviceArray:
        return self.state.sinogram() if name == "light" else self.state.volume()

    def _begin(self) -> None:
        """The previous light, scaled to a dose of at most 1; lengths of steps."""
        state, memory, upload = self.state, self.memory, self.state.device.upload
        light = state.buffer("light")
        for name in ("rows", "columns", "held"):
            memory[name] = self._empty("light" if name == "columns" else name)
        rows, held, mask = memory["rows"], memory["held"], upload(state.evaluation_mask())
        # −1 for light that subtracts dose, else 1; 0 at angles that are already decided
        even = upload(getattr(state.operator, "signs", np.ones(light.shape, np.float32)))
        if state.partial is not None:
            state.device.launch(weigh_poses, light=even, times=state.partial.free, weighted=even)
        state.operator.T(even, out=rows)  # the evaluation that every method spends
        if state.partial is not None:
            state.device.launch(multiply, x=rows, y=mask, out=rows)
        state.expose(light, held)
        unit = MEAN_ROW * total(mask) / max(dot(rows, mask), 1e-30)
        state.scale(unit, rows, rows)
        memory["unit"] = unit
        self._measure(even)
        greatest = state.window(held)[1]
        for field in (light, held) if state.partial is None else ():
            state.scale(1.0 / greatest, field, field)
        for name in ("lower", "upper"):
            memory[name] = upload(np.zeros(held.shape, np.float32))
        least, leak, _ = state.extremes(held)
        memory |= dict(zip(LEVELS, (least, max(leak, 0.0), 0.0, 0.0), strict=True))
        multipliers = 2.0 * (MEAN_ROW + 1.0) / (ACTIVE * max(memory["inside voxels"], 1.0))
        far = max(dot(light, light) * self._mean_column(), 1e-30)
        memory |= {"length": 1.0, "weight": sqrt(multipliers / far), "made": 0.0}
        self._anchor(memory, memory)

    def _measure(self, signs: DeviceArray) -> None:
        """Number of limits, and the sum of what a free pixel adds to all of them."""
        state, memory = self.state, self.memory
        limits = state.evaluation_mask() * (1.0 + (state.target.numpy() >= 0.5)).astype(np.float32)
        memory |= {
            f"{side} voxels": float(np.count_nonzero(limits == n)) for side, n in (("inside", 2), ("outside", 1))
        }
        state.project(state.device.upload(limits), memory["columns"])
        state.device.launch(multiply, x=memory["columns"], y=signs, out=memory["columns"])
        state.scale(1.0 / memory["unit"], memory["columns"], memory["columns"])

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

    def _reflect(self, share: float) -> None:
        """Go beyond the next point, pulled back by the anchor."""
        memory = self.memory
        for name in FIELDS:
            now, anchor = memory[name], memory[f"{name} anchor"]
            combine(2.0 * share, self.after[name], -share, now, now)
            combine(1.0, now, 1.0 - share, anchor, now)
        for name in LEVELS:
            beyond = 2.0 * self.levels[name] - memory[name]
            memory[name] = share * beyond + (1.0 - share) * memory[f"{name} anchor"]

    def _balance(self) -> None:
        """Balance light and multipliers by the distance that each moved in the round."""
        way = {}
        for name in FIELDS[:3]:
            moved = combine(1.0, self.after[name], -1.0, self.memory[f"{name} anchor"], self.memory[name])
            way[name] = dot(moved, moved)
        primal = way["light"] * self._mean_column()
        dual = (MEAN_ROW + 1.0) * way["lower"] + MEAN_ROW * way["upper"]
        if primal > 0.0 and dual > 0.0:
            self.memory["weight"] = (dual / primal) ** 0.15 * self.memory["weight"] ** 0.7

    def _step(self) -> float:
        """Find the next point; return its distance, and set the length of the next step."""
        state, memory, launch, levels = self.state, self.memory, self.state.device.launch, self.levels
        length, weight, after = memory["length"], memory["weight"], self.after
        launch(dual_dose, lower=memory["lower"], upper=memory["upper"], target=state.target, pull=self.pull)
        state.project(self.pull, self.descent)
        moved = parts_for(primal_step, self.descent)
        launch(
            primal_step, light=memory["light"], columns=memory["columns"], step=length / weight,
            most=min(state.most, UNLIMITED), ahead=self.descent, after=after["light"], moved=moved,
        )  # fmt: skip
        gap = self._move_levels(length, weight)
        state.expose(self.descent, after["held"])
        parts = {name: parts_for(dual_step, self.pull) for name in ("inside", "outside", "moved", "crossed")}
        launch(
            dual_step, ahead=after["held"], held=memory["held"], target=state.target, rows=memory["rows"],
            least=2.0 * levels["least"] - memory["least"], leak=2.0 * levels["leak"] - memory["leak"],
            step=length * weight, reach=state.reach, lower=memory["lower"], upper=memory["upper"],
            lower_after=after["lower"], upper_after=after["upper"], **parts,
        )  # fmt: skip
        found = sums({"light": moved, **parts})
        levels |= {"inside": found["inside"], "outside": found["outside"]}
        combine(0.5, after["held"], 0.5, memory["held"], after["held"])
        gap += weight / length * found["light"] + found["moved"] / (length * weight)
        crossed = found["crossed"] + sum(
            sign * (levels[level] - memory[level]) * (levels[side] - memory[side]) for level, side, sign in SIDES
        )
        safe = gap / max(2.0 * abs(crossed), 1e-30)  # a step this many times as long would have been safe
        made = memory["made"] = state.number("made") + 1.0
        most = min((1.0 - (made + 1.0) ** -0.3) * safe, 1.0 + (made + 1.0) ** -0.6)
        memory["length"] = min(max(LENGTHS[0], most * length), LENGTHS[1])
        return sqrt(gap)

    def _move_levels(self, length: float, weight: float) -> float:
        """Step a and b, no farther apart than a partial problem needs; return their distance."""
        memory, levels, partial = self.memory, self.levels, self.state.partial
        gap = 0.0
        for number, (level, side, sign) in enumerate(SIDES):
            voxels = memory[f"{side} voxels"]
            pace = 0.5 * length / (weight * max(voxels, 1.0))
            levels[level] = memory[level] + sign * pace * (1.0 - memory[side]) * (voxels > 0)
            if level == "leak":
                levels[level] = max(levels[level], 0.0)  # a dose below 0 counts as 0
            if partial is not None and partial.levels is not None:
                levels[level] = sign * min(sign * levels[level], sign * partial.levels[number])
            gap += (levels[level] - memory[level]) ** 2 / pace
        return gap

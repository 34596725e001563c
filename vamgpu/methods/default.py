"""The default: the widest process window that the evaluations a run may spend buy."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, prod
from typing import ClassVar

from vamgpu.methods.certificate import Bound
from vamgpu.methods.corners import owed
from vamgpu.methods.method import Criterion, Method, Steps
from vamgpu.methods.split import split_steps
from vamgpu.methods.state import OptimizerState
from vamgpu.methods.widest import WidestWindow
from vamgpu.methods.window import ProcessWindow
from vamgpu.operators.scenarios import Scenarios

MANY = 64.0
"""Evaluations from which on prices lead to a wider window than thresholds, on slices."""
VOXELS = 110.0
"""Voxels of a solid that each evaluation must stand for at most for prices to lead."""
CORNERS, FIRST = 400.0, 200.0
"""Evaluations of every scenario from which on prices follow the thresholds, and those that thresholds have before."""
VOLUMES, SINOGRAMS = 12, 6
"""Memory that prices take."""


@dataclass(frozen=True)
class BestWindow(Method):
    """`WidestWindow` where the light of one pose turns; else `ProcessWindow` for runs of few evaluations.

    Elsewhere, and where light may not be too bright, prices follow where a run may spend 64 evaluations, and one for
    every 110 voxels. With tolerances thresholds come first there: a run that may spend 400 evaluations of every corner
    goes on by prices after 200, and begins with what voxels that stay off weigh.

    Bodies with weights are `ProcessWindow`'s at any number, and gray ones, whose doses it keeps right where no light
    has a window above 0.

    A plan that is resumed with so many more goes on by prices, from its best light. Where the device lacks the memory
    for prices it stays with thresholds.
    """

    papers: ClassVar[tuple[str, ...]] = tuple(dict.fromkeys((*ProcessWindow.papers, *WidestWindow.papers)))
    iterations: ClassVar[int] = ProcessWindow.iterations
    cost: ClassVar[float] = 1.0
    criterion: ClassVar[Criterion] = "window"
    takes_start: ClassVar[bool] = True

    def steps(self, state: OptimizerState) -> Steps:
        memory, scenarios = state.memory, state.operator
        corners = len(scenarios) if isinstance(scenarios, Scenarios) and len(scenarios) > 1 else 0
        undecided = not memory.get("priced") and not _by_thresholds(state)
        split = split_steps(state) if undecided or "free" in memory else None
        if split is not None:
            if undecided:
                memory |= {"priced": 1.0, "turned": 1.0}
                memory.pop("heavy", None)
                _turn(state)
            yield from split.steps()
            return
        if undecided and _many(state, corners) and state.has_room(VOLUMES, SINOGRAMS):
            memory["priced"] = 1.0
            memory["thresholds until"] = max(state.evaluations, FIRST * corners) if state.brightness == inf else 0.0
            if not corners:
                _turn(state)
        if corners and memory.get("priced") and not memory.get("turned"):
            own = ProcessWindow().steps(state)
            while state.evaluations < state.number("thresholds until") and (record := next(own, None)) is not None:
                yield record
            own.close()
            _turn(state)
            memory["turned"] = 1.0
        yield from (WidestWindow() if memory.get("priced") else ProcessWindow()).steps(state)

    def certify(self, state: OptimizerState) -> Bound | None:
        """That of `WidestWindow`.

        Args:
            state: Of the run.

        Returns:
            The bound; None where thresholds led, or few prices.
        """
        return WidestWindow().certify(state)


def _turn(state: OptimizerState) -> None:
    """From the best light by thresholds to prices."""
    memory = state.memory
    if "heavy" in memory:
        owed(state)
    if "best" in memory:
        state.scale(1.0, state.buffer("best"), state.buffer("light"))
        memory["stage"] = state.iteration
    for name in ("ahead", "dose", "resting", "heavy"):
        memory.pop(name, None)


def _many(state: OptimizerState, corners: int) -> bool:
    """Whether prices lead: for a run that may spend enough, and for one whose light may not be too bright."""
    enough = CORNERS * corners if corners else max(MANY, prod(state.operator.domain.shape) / VOXELS)
    return state.budget - state.evaluations >= enough or state.brightness < inf


def _by_thresholds(state: OptimizerState) -> bool:
    """Whether bodies ask for what thresholds do better."""
    return state.limits is not None and (state.limits.weighted or bool(state.limits.gray.any()))

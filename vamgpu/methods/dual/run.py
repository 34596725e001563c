"""`superpose`: light of two colors by any rule."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from vamgpu.backend.array import DeviceArray
from vamgpu.errors import BadInput
from vamgpu.geometry import positive
from vamgpu.methods.certificate import Bound
from vamgpu.methods.choice import instance
from vamgpu.methods.dual.colors import Colors, DualPlan, Pair, Pass
from vamgpu.methods.dual.least_squares import LeastSquares
from vamgpu.methods.dual.passes import DualColor, DualState, Rule, SingleColor, Tolerant
from vamgpu.methods.dual.window import BothColors, WidestWindow
from vamgpu.methods.part import check_values, on_device, one_limit
from vamgpu.methods.pdhg import PDHG, TOLD
from vamgpu.methods.state import OptimizerState
from vamgpu.operators.compose import combine
from vamgpu.operators.reductions import EVERYWHERE, extent

METHODS: dict[str, Callable[[], Any]] = {
    "sc": SingleColor,
    "sc2": Tolerant,
    "dc": DualColor,
    "dc kept": lambda: DualColor(recompute=False),
    "least squares": LeastSquares,
    "window": WidestWindow,
}
"""Names of rules with default parameters."""


def superpose(
    colors: Colors,
    design: Any,
    method: str | Rule = "least squares",
    *,
    progress: Callable[[Pass], None] | None = None,
    cancel: Callable[[], bool] | None = None,
) -> DualPlan:
    """Find visible and UV light [angle, r, z] ≥ 0 whose difference of doses is the design, on the colors' device.

    Doses add linearly, and one unit of UV dose cancels ``colors.strength`` units of visible dose, without chemistry.

    Args:
        colors: Operators of both colors.
        design: A `Target`, or gray values 0..1 [x, y, z] (NumPy or on the device).
        method: A name of `METHODS` or an instance.
        progress: Gets every `Pass`.
        cancel: Called after each pass; if it returns true, the plan so far is returned.

    Returns:
        The plan.

    Raises:
        BadInput: A value is out of its range.
        ShapeMismatch: Shapes do not fit.
        EmptyMesh: No voxel is in the part, or none is outside.
        DeviceError: Arrays are on different devices.
    """
    rule: Rule = instance("rule", method, METHODS, "an instance such as Tolerant()")
    started = time.perf_counter()
    state, history = DualState(colors, _checked(colors, design)), []
    for record in rule.steps(state):
        history.append(record)
        if progress is not None:
            progress(record)
        if cancel is not None and cancel():
            break
    seconds = time.perf_counter() - started
    return DualPlan(state.light, state.uv, colors, rule, tuple(history), seconds, rule.papers)


def bound(plan: DualPlan, design: Any, evaluations: int = 1500, brighter: float = 2.0) -> Bound:
    """Bound the window of any light of both colors, up to ``brighter`` times as bright as that of a plan.

    Both colors may cancel each other, so without a limit of the light the bound is rarely below 1. The window's linear
    program is solved by `PDHG`, from the light of the plan; doses add up.

    Args:
        plan: A plan whose dose is that of its colors.
        design: The design of the plan.
        evaluations: Projector evaluations of both colors.
        brighter: Greatest light of a pixel, relative to the plan's at the same greatest dose.

    Returns:
        The bound; ``bound.share(window)`` compares a window with it.

    Raises:
        BadInput: A value is out of its range, or there are too few evaluations.
    """
    if evaluations < TOLD:
        raise BadInput(f"evaluations is {evaluations!r}; expected {TOLD} or more: fewer steps give no bound")
    colors, brighter = plan.colors, positive("brighter", brighter)
    both: Any = BothColors(colors.visible, colors)
    uv = combine(0.0, plan.visible, 0.0, plan.visible, both.device.empty(plan.visible.shape))
    light = both.join(Pair(plan.visible, uv if plan.uv is None else plan.uv), both.device.empty(both.range.shape))
    run = OptimizerState(both, _checked(colors, design), {"light": light})
    run.reach = EVERYWHERE if colors.whole else run.reach
    run.most = brighter * extent(light)[1] / run.window(both.T(light))[1]
    for _ in zip(range(evaluations), PDHG().steps(run)):  # noqa: B905
        pass
    found = PDHG().certify(run)
    assert found is not None
    return found


def _checked(colors: Colors, design: Any) -> DeviceArray:
    projector: Any = colors.visible
    values = on_device(projector, one_limit(design))
    check_values(values, "the design", "gray values")
    return values

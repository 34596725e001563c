"""`superpose`: light of two colors by any rule."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from vamgpu.backend.array import DeviceArray
from vamgpu.errors import BadInput, EmptyMesh
from vamgpu.methods.dual.colors import Colors, DualPlan, Pass
from vamgpu.methods.dual.least_squares import LeastSquares
from vamgpu.methods.dual.passes import DualColor, DualState, Rule, SingleColor, Tolerant
from vamgpu.methods.part import on_device, one_limit
from vamgpu.operators.reductions import extent
from vamgpu.schema.registry import as_known, nearest

METHODS: dict[str, Callable[[], Any]] = {
    "sc": SingleColor,
    "sc2": Tolerant,
    "dc": DualColor,
    "dc kept": lambda: DualColor(recompute=False),
    "least squares": LeastSquares,
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
    rule = _rule(method)
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


def _checked(colors: Colors, design: Any) -> DeviceArray:
    projector: Any = colors.visible
    values = on_device(projector, one_limit(design))
    low, high = extent(values)
    if not (low >= 0.0 and high <= 1.0):
        raise BadInput(f"the design reaches from {low:g} to {high:g}; expected gray values in 0..1: scale it")
    if high == 0.0:
        raise EmptyMesh("every voxel of the design is 0; expected some that are filled")
    return values


def _rule(method: str | Rule) -> Rule:
    if isinstance(method, str):
        method = as_known(method, METHODS)
        if method not in METHODS:
            near = nearest(method, METHODS)
            raise BadInput(f"no rule {method!r}; there are {', '.join(METHODS)}, or give an instance{near}")
        return METHODS[method]()
    if isinstance(method, type) or not hasattr(method, "steps"):
        raise BadInput(f"got {method!r} as rule; expected a name ({', '.join(METHODS)}) or e.g. Tolerant()")
    return method

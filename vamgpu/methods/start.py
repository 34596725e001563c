"""A run that starts from the caller's light."""

from __future__ import annotations

from math import isfinite
from typing import Any

from vamgpu.backend.array import DeviceArray
from vamgpu.errors import BadInput, NoLight
from vamgpu.methods.fbp import filtered_light
from vamgpu.methods.method import Method
from vamgpu.methods.plan import Plan
from vamgpu.methods.state import OptimizerState
from vamgpu.operators.reductions import extent, total
from vamgpu.operators.space import require

SAME = 2.0  # factor within which light is assumed to be in units of the part's dose


def own_light(operator: Any, light: Any, name: str) -> DeviceArray:
    """Light [angle, r, z] of any library on an operator's device. Raises `BadInput`, `ShapeMismatch`."""
    light = getattr(light, "sinogram", light)
    require(operator.range, light, name)
    field = operator.device.field(light)
    if not isfinite(total(field)):
        raise BadInput(f"{name} holds NaN or infinity; expected finite light ≥ 0: check its source")
    least, greatest = extent(field)
    if not least >= 0.0:
        raise BadInput(f"{name} reaches from {least:g} to {greatest:g}; expected none below 0: clip it")
    return field


def begin(state: OptimizerState, method: Method, start: Any, resume: Plan | None, scale: float = 1.0) -> None:
    """Put light, times ``scale``, into the memory of a run as ``light``; None: that of filtered back projection."""
    if resume is not None:
        raise BadInput("got both resume and start; a resumed run continues from its own light: leave one out")
    if not getattr(method, "takes_start", False):
        raise BadInput(
            f"{type(method).__name__} begins with the target, not with light; expected no start and iterations ≥ 1, or "
            'a method such as "default", "lbfgs", "bclp", "penalty" or "cal"'
        )
    if start is None:
        filtered_light(state, state.volume())
        return
    source = own_light(state.operator, start, "the initial light")
    light, dose = state.sinogram(), state.volume()
    state.scale(scale, source, light)
    state.expose(light, dose)
    level = state.part_mean(dose)
    if not level > 1e-30:
        raise NoLight("the initial light gives the part no dose; expected some: check its angles and its axes")
    if not 1.0 / SAME <= level <= SAME:
        state.scale(1.0 / level, light, light)
    state.memory.update({"light": light, "started": 1.0})
    window, _ = state.window(dose)
    if method.criterion == "window":  # the run then never returns worse light than its start
        state.offer(1.0 - window, window, 0)

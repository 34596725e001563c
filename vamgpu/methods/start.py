"""A run that begins with light of the caller's."""

from __future__ import annotations

from typing import Any

from vamgpu.errors import BadInput, NoLight
from vamgpu.methods.method import Method
from vamgpu.methods.plan import Plan
from vamgpu.methods.state import OptimizerState
from vamgpu.operators.reductions import extent
from vamgpu.operators.space import require

SAME = 2.0
"""Factor within which light counts as meant in units of the part's dose."""


def begin(state: OptimizerState, method: Method, start: Any, resume: Plan | None) -> None:
    """Put light into the memory of a run as ``light``; half an evaluation.

    Raises:
        BadInput: the method begins with the target, a plan is resumed, or light is negative or of another shape.
        NoLight: the light misses the part.
    """
    if resume is not None:
        raise BadInput("got both resume and start; a resumed run goes on from its own light: leave one out")
    if not getattr(method, "takes_start", False):
        raise BadInput(
            f"{type(method).__name__} begins with the target, not with light; expected no start, or a method such as "
            '"default", "lbfgs", "bclp", "penalty", "cal" or "widest"'
        )
    given = start.sinogram if isinstance(start, Plan) else start
    require(state.operator.range, given, "the light to start from")
    source, light, dose = state.device.field(given), state.sinogram(), state.volume()
    least, greatest = extent(source)
    if not least >= 0.0:
        raise BadInput(f"the light to start from reaches from {least:g} to {greatest:g}; clip what is below 0")
    state.scale(1.0, source, light)
    state.expose(light, dose)
    level = state.part_mean(dose)
    if not level > 1e-30:
        raise NoLight("the light to start from gives the part no dose; expected some: check its angles and its axes")
    if not 1.0 / SAME <= level <= SAME:
        state.scale(1.0 / level, light, light)
    state.memory.update({"light": light, "started": 1.0})
    window, _ = state.window(dose)
    if method.criterion == "window":  # so that no worse light is returned
        state.offer(1.0 - window, window, 0)

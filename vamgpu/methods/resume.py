"""The state that a run takes over from an earlier plan."""

from __future__ import annotations

from typing import Any

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.methods.method import Method
from vamgpu.methods.plan import Plan, copied
from vamgpu.methods.tolerances import Tolerances
from vamgpu.operators.protocol import Operator


def memory_of(
    operator: Operator, target: Any, method: Method, resume: Plan | None, tolerances: Tolerances | None
) -> dict[str, Any]:  # fmt: skip
    """A copy of a plan's memory; the plan does not change. Raises `BadInput` for a plan of another task."""
    if resume is None:
        return {}
    if resume.history and not resume.state:
        raise BadInput("the plan to resume was saved without its state, which resuming needs; give its light as "
                       "start, or save it with state=True")  # fmt: skip
    if resume.operator.device is not operator.device or resume.sinogram.shape != operator.range.shape:
        raise BadInput(
            f"the plan to resume has light {resume.sinogram.shape} on {resume.operator.device}; expected "
            f"{operator.range.shape} on {operator.device}: resume with the operator that made it"
        )
    if resume.operator.domain.shape != operator.domain.shape:
        raise BadInput(f"the plan to resume has a dose of {resume.operator.domain.shape}, the operator one of "
                       f"{operator.domain.shape}; resume with the operator that made it")  # fmt: skip
    if resume.method != method:
        raise BadInput(f"the plan to resume is by {resume.method!r}, not by {method!r}; resume with the same method")
    if other := _difference(resume, operator, target, tolerances):
        raise BadInput(f"the plan to resume is of {other}; resume that task, or give its light as start")
    return copied(resume.state)


def _difference(plan: Plan, operator: Operator, target: Any, tolerances: Tolerances | None) -> str:
    """Differences between the tasks of two plans, in words; empty if the tasks are equal."""
    for name in ("grid", "beam", "motion", "vessel"):
        before, now = (getattr(each, name, None) for each in (plan.operator, operator))
        alike = repr(before) == repr(now) if name == "vessel" else before == now  # media do not implement ==
        if not alike:
            return f"{before!r}, not of {now!r}"
    if plan.tolerances != tolerances:
        return f"{plan.tolerances!r}, not of {tolerances!r}"
    if plan.target is not None and plan.target is not target:
        before, now = (np.asarray(getattr(each, "numpy", lambda each=each: each)()) for each in (plan.target, target))
        if before.shape != now.shape or not np.array_equal(before, now):
            return "another target"
    return ""

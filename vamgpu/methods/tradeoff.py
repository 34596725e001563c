"""Window against exposure time: the widest windows for a series of shorter exposure limits."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from vamgpu.errors import BadInput, OpticsWarning
from vamgpu.geometry import positive
from vamgpu.methods.limit import ExposureLimit
from vamgpu.methods.plan import Plan
from vamgpu.methods.run import optimize
from vamgpu.methods.surface import across
from vamgpu.operators.projection import Projection
from vamgpu.operators.ring_projection import RingProjection

SHARES = (0.75, 0.55, 0.4, 0.3, 0.2, 0.14, 0.1)  # limits of the other exposures, as shares of the time of the plan


@dataclass(frozen=True)
class ParetoPoint:
    """Window and time of one light, before packing.

    Attributes:
        seconds: Exposure time, until the dose midway between part and void is the critical dose.
        window: Process window a pixel or more from the surface, a share of the greatest dose.
        outside: Mean dose outside the part divided by the mean in it.
    """

    seconds: float
    window: float
    outside: float


def pareto(
    plan: Plan, *, irradiance: float | str, critical_dose: float | str, absorption: float | str | None = None,
    evaluations: float | None = None, progress: Callable[[float], None] = lambda share: None,
) -> tuple[ParetoPoint, ...]:  # fmt: skip
    """Windows against times: that of a plan, and the widest ones for limits of 75 % of its time, and less.

    Each run starts from the patterns of the previous one. The series ends when no patterns print any more.

    Args:
        plan: A plan by the default method, without tolerances; all runs use its operator and target.
        irradiance: Irradiance of a full-on pixel in air [mW/mm²], or text with its unit.
        critical_dose: Dose from which resin is solid [mJ/mm³], or text with its unit.
        absorption: Absorption of the resin [1/mm], if the operator absorbs no light.
        evaluations: Projector evaluations of each run; by default those of the plan, but at least 100.
        progress: Receives the share of the runs that are done.

    Returns:
        The points, the longest time first.

    Raises:
        BadInput: The plan has tolerances, bodies with limits of their own, or no target, or a number is out of range.
    """
    lamp = {"irradiance": irradiance, "critical_dose": critical_dose, "absorption": absorption}
    limit = ExposureLimit.of(1.0, **lamp)
    assert limit is not None
    if not isinstance(plan, Plan):
        raise BadInput(f"plan is {plan!r}; expected a Plan, of optimize() or of vam.load()")
    if evaluations is not None:
        evaluations = positive("evaluations", evaluations)
    several = {
        "tolerances": plan.tolerances is not None,
        "bodies with limits of their own": getattr(plan.target, "limits", None) is not None,
        "no target": plan.target is None,
    }
    if why := [name for name, holds in several.items() if holds]:
        raise BadInput(f"a series of exposures got a plan with {' and '.join(why)}; expected one part and one machine")
    points, light = [_point(plan, limit)], plan
    for done, share in enumerate(SHARES):
        progress(done / len(SHARES))
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", OpticsWarning)
                light = optimize(
                    plan.operator, plan.target, evaluations=evaluations or max(plan.evaluations, 100.0),
                    start=light, progress=False, exposure_limit=share * points[0].seconds, **lamp,
                )  # fmt: skip
        except BadInput:  # a shorter time than full-on pixels everywhere need
            break
        point = _point(light, limit)
        if not point.window > 0.0:
            break
        points.append(point)
    progress(1.0)
    return tuple(points)


def _point(plan: Plan, limit: ExposureLimit) -> ParetoPoint:
    """Window and time of a plan's light."""
    operator: Any = plan.operator
    near = np.broadcast_to(operator.grid.cylinder()[:, :, None], operator.grid.shape)
    target = plan.target.numpy() if hasattr(plan.target, "numpy") else np.asarray(plan.target)
    dose = operator.T(plan.sinogram).numpy()
    part, void = dose[near & (target >= 0.5)], dose[near & (target < 0.5)]
    outside = float(void.mean() / part.mean()) if void.size else 0.0
    seconds = limit.seconds_of(operator, plan.sinogram, 0.5 * sum(_ends(part, void)))
    if isinstance(operator, Projection | RingProjection):  # light cannot make the dose jump at the surface
        ramp = across(plan.target, operator.grid, operator, 1.0).numpy()
        deep, void = dose[near & (ramp >= 1.0)], dose[near & (ramp <= 0.0)]
        part = deep if deep.size else part
    least, leak = _ends(part, void)
    return ParetoPoint(seconds, (least - leak) / float(dose[near].max()), outside)


def _ends(part: np.ndarray, void: np.ndarray) -> tuple[float, float]:
    """The least dose of a part, and the greatest outside it (0 if there is none)."""
    return float(part.min()), max(0.0, float(void.max(initial=0.0)))

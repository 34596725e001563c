"""How wide a process window any light can have."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from vamgpu.errors import BadInput
from vamgpu.methods.certificate import Bound
from vamgpu.methods.plan import Plan
from vamgpu.methods.projector import Projector
from vamgpu.methods.run import Progress, optimize
from vamgpu.methods.widest import TOLD, WidestWindow


def bound(
    operator: Projector,
    target: Any,
    plan: Plan | None = None,
    evaluations: float = 1500.0,
    *,
    progress: bool | Progress | None = None,
    cancel: Callable[[], bool] | None = None,
) -> Bound:
    """Bound the strict process window of every light there is: ``bound(A, target).share(plan)``.

    It runs `WidestWindow`, whose prices tell; on ten slices the bound is 4 to 17 % above the optimum after 400
    evaluations, 1 to 3 % after 1000 and some 1 % after 1500. Whoever wants the light of such a run too asks
    `optimize` for it: its plan holds the bound.

    Args:
        operator: The projector.
        target: A `Target`, or fractions [x, y, z].
        plan: One with a bound for the same operator and target, to go on from; any other has no prices.
        evaluations: Projector evaluations of the run, those of such a plan included; six more make the bound.
        progress: As for `optimize`.
        cancel: As for `optimize`.

    Returns:
        The bound; that of the plan where it is lower.

    Raises:
        BadInput: As `optimize` does, and for too few evaluations.
    """
    prices = plan if plan is not None and plan.bound is not None else None
    how = WidestWindow() if prices is None else prices.method
    least = WidestWindow.passes + TOLD + 1
    if not evaluations >= least:
        raise BadInput(f"evaluations is {evaluations!r}; expected {least} or more: fewer steps tell no bound")
    found = optimize(
        operator, target, how, evaluations=evaluations, resume=prices, progress=progress, cancel=cancel
    ).bound
    before = None if prices is None else prices.bound
    known = [each for each in (found, before) if each is not None]
    return min(known, key=lambda each: each.value)

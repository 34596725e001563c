"""How wide a process window any light can have."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import ceil
from operator import index
from typing import Any

import numpy as np

from vamgpu.errors import BadInput, Cancelled
from vamgpu.geometry import Grid, positive
from vamgpu.methods.certificate import Bound
from vamgpu.methods.default import CORNERS, BestWindow
from vamgpu.methods.plan import Plan
from vamgpu.methods.projector import Projector
from vamgpu.methods.run import Progress, of_another, optimize
from vamgpu.methods.tolerances import Tolerances, check_tolerances
from vamgpu.methods.widest import TOLD, WidestWindow
from vamgpu.operators.gram import RIM, against_gram
from vamgpu.operators.projection import Projection
from vamgpu.operators.ring_projection import RingProjection

REACHED = 6.0
"""Standard deviations that a point spread reaches."""


def bound(
    operator: Projector,
    target: Any,
    plan: Plan | None = None,
    evaluations: float = 1500.0,
    *,
    tolerances: Tolerances | None = None,
    slices: tuple[int, int] | None = None,
    progress: bool | Progress | None = None,
    cancel: Callable[[], bool] | None = None,
) -> Bound:
    """Bound the strict process window of every light there is: ``bound(A, target).share(plan)``.

    It runs `WidestWindow`, whose prices tell; on ten slices the bound is within 3 % of the optimum after 400
    evaluations and within 1 % after 1000, where light turns. Whoever wants the light of such a run too asks `optimize`
    for it: its plan holds a bound.

    With tolerances it is the window at all corners. What no light exceeds on some slices it exceeds on none but these,
    so that a bound of the few that are hardest is one of the whole print, sooner near and at a fraction of the cost.

    Args:
        operator: The projector.
        target: A `Target`, or fractions [x, y, z].
        plan: One with a bound for the same operator and target, to go on from; any other has no prices.
        evaluations: Projector evaluations of the run, those of such a plan included; six more make the bound.
        tolerances: How far machine and resin may be off; evaluations of every corner count.
        slices: First slice, and the one behind the last, of those that alone are asked for; prices are theirs. For a
            `Projection` whose rows are as high as its voxels.
        progress: As for `optimize`.
        cancel: Asked before each step; the bound is that of the prices so far.

    Returns:
        The bound; that of the plan where it is lower.

    Raises:
        BadInput: As `optimize` does, for too few evaluations, and for slices that are not there.
        Cancelled: Before there are prices that tell.
    """
    if plan is not None and not isinstance(plan, Plan):
        raise BadInput(f"plan is {plan!r}; expected a Plan whose run is to go on, or None; bound(…).share tells how "
                       "near a light comes")  # fmt: skip
    check_tolerances(tolerances)
    evaluations = positive("evaluations", evaluations)
    prices = plan if plan is not None and plan.bound is not None else None
    if prices is not None and (other := of_another(prices, operator, target, tolerances)):
        raise BadInput(f"the bound of the plan is of {other}; leave the plan out")
    known_before = None if prices is None else prices.bound
    if prices is not None and "free" in prices.state and getattr(prices.method, "rim", RIM):
        prices = None  # what holds voxels dark that nobody judges has prices there, which tell nothing
    if slices is not None:
        if prices is not None:
            raise BadInput("got a plan with a bound, and slices; expected one of them: its prices are of all slices")
        operator, target = _of_slices(operator, target, slices, tolerances)
    how = prices.method if prices is not None else WidestWindow(rim=0.0)
    least = WidestWindow.passes + TOLD + 1
    first = tolerances is not None and prices is None and evaluations >= CORNERS * len(tolerances.corners())
    if first and against_gram(operator):  # thresholds first, whose weights are the first prices
        how = BestWindow()
    if not evaluations >= least:
        raise BadInput(f"evaluations is {evaluations!r}; expected {least} or more: fewer steps tell no bound")
    try:
        found = optimize(
            operator, target, how, evaluations=evaluations, resume=prices, tolerances=tolerances, progress=progress,
            cancel=cancel,
        ).bound  # fmt: skip
    except Cancelled as error:
        found = error.plan.bound if isinstance(error.plan, Plan) else None
        if found is None:
            raise
    known = [each for each in (found, known_before) if each is not None]
    if not known:
        raise BadInput(f"{evaluations:g} evaluations of all corners tell no bound; expected more")
    return min(known, key=lambda each: each.value)


def _of_slices(
    operator: Any, target: Any, slices: tuple[int, int], tolerances: Tolerances | None
) -> tuple[Projection, np.ndarray]:
    """A projector of some slices, with all the rows of light that reach them, and their fractions [x, y, z]."""
    try:
        first, behind = (index(each) for each in slices)
    except (TypeError, ValueError):
        raise BadInput(f"slices are {slices!r}; expected two whole numbers: the first, and the one behind the last, "
                       "such as (40, 44)") from None  # fmt: skip
    operator = operator.direct if isinstance(operator, RingProjection) else operator
    if type(operator) is not Projection or not np.isclose(operator.beam.pitch, operator.grid.pitch):
        raise BadInput(f"slices of {operator!r} cannot be asked for alone; expected a Projection whose pixels are as "
                       "large as its voxels")  # fmt: skip
    if getattr(target, "limits", None) is not None:
        raise BadInput("slices of a target with bodies cannot be asked for alone; expected a part: leave slices out")
    shape, (columns, rows), pitch = operator.grid.shape, operator.beam.pixels, operator.grid.pitch
    if not 0 <= first < behind <= shape[2]:
        raise BadInput(f"slices are {slices!r}; expected 0 ≤ first < behind ≤ {shape[2]}")
    if (shape[2] - rows) % 2:
        raise BadInput(f"{rows} rows light {shape[2]} slices, so that every row lies between two of them; expected "
                       "an even difference, or no slices")  # fmt: skip
    spreads = [operator.beam.sigma * pitch, *(tolerances.spread or () if tolerances is not None else ())]
    beyond = 2 * ceil(REACHED * max(spreads) / pitch)
    grid = Grid((*shape[:2], behind - first), pitch)
    beam = replace(operator.beam, pixels=(columns, behind - first + beyond))
    values = target.numpy() if hasattr(target, "numpy") else np.asarray(target)
    small = Projection(grid, beam, operator.motion, operator.vessel, operator.device, footprint=operator.footprint)
    chosen = np.ascontiguousarray(values[:, :, first:behind], np.float32)
    if not (chosen >= 0.5).any():
        raise BadInput(f"no voxel of the part lies on slices {first} to {behind - 1}; expected slices that have some")
    return small, chosen

"""Upper bound on the process window of any patterns."""

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
from vamgpu.methods.pdhg import PDHG, TOLD
from vamgpu.methods.plan import Plan
from vamgpu.methods.progress import Progress
from vamgpu.methods.run import optimize
from vamgpu.methods.tolerances import Tolerances, check_tolerances
from vamgpu.operators.projection import Projection
from vamgpu.operators.protocol import Operator
from vamgpu.operators.ring_projection import RingProjection

REACHED = 6.0  # standard deviations after which a point spread is cut off


def bound(
    operator: Operator,
    target: Any,
    evaluations: float = 1500.0,
    *,
    tolerances: Tolerances | None = None,
    slices: tuple[int, int] | None = None,
    progress: bool | Progress | None = None,
    cancel: Callable[[], bool] | None = None,
) -> Bound:
    """Bound the strict process window of any patterns: ``bound(A, target).share(plan)``.

    The window's linear program is solved by PDHG (A. Chambolle, T. Pock, J. Math. Imaging Vis. 40 (2011) 120), whose
    multipliers make the bound. After 1500 evaluations it is within 1 % of the optimum on slices.

    With tolerances it bounds the window at all corners. A bound for some slices also holds for the whole print; the
    bound of the few hardest slices converges sooner and at a fraction of the cost.

    Args:
        operator: The projector.
        target: A `Target`, or fractions [x, y, z].
        evaluations: Projector evaluations of the run; the bound takes six more.
        tolerances: Tolerances of machine and resin; evaluations of every corner count.
        slices: First slice, and the one after the last, of a bound for only these slices; its dual variables cover only
            them. For a `Projection` whose rows are as high as its voxels.
        progress: As for `optimize`.
        cancel: Called before each step; the bound is then that of the current dual variables.

    Returns:
        The bound.

    Raises:
        BadInput: As for `optimize`, for too few evaluations, and for slices that do not exist.
        Cancelled: There are no useful dual variables yet.
    """
    check_tolerances(tolerances)
    evaluations = positive("evaluations", evaluations)
    if slices is not None:
        operator, target = _of_slices(operator, target, slices, tolerances)
    if not evaluations >= TOLD + 3:
        raise BadInput(f"evaluations is {evaluations!r}; expected {TOLD + 3} or more: fewer steps give no bound")
    try:
        found = optimize(
            operator, target, PDHG(), evaluations=evaluations, tolerances=tolerances, progress=progress, cancel=cancel
        ).bound
    except Cancelled as error:
        found = error.plan.bound if isinstance(error.plan, Plan) else None
        if found is None:
            raise
    if found is None:
        raise BadInput(f"{evaluations:g} evaluations of all corners give no bound; expected more")
    return found


def _of_slices(
    operator: Any, target: Any, slices: tuple[int, int], tolerances: Tolerances | None
) -> tuple[Projection, np.ndarray]:
    """A projector of some slices, with all rows of light that reach them, and their fractions [x, y, z]."""
    try:
        first, behind = (index(each) for each in slices)
    except (TypeError, ValueError):
        raise BadInput(f"slices are {slices!r}; expected two whole numbers: the first, and the one after the last, "
                       "such as (40, 44)") from None  # fmt: skip
    operator = operator.direct if isinstance(operator, RingProjection) else operator
    if type(operator) is not Projection or not np.isclose(operator.beam.pitch, operator.grid.pitch):
        raise BadInput(f"slices of {operator!r} cannot be bounded alone; expected a Projection whose pixels are as "
                       "large as its voxels")  # fmt: skip
    if getattr(target, "limits", None) is not None:
        raise BadInput("slices of a target with bodies cannot be bounded alone; expected a part: leave slices out")
    shape, (columns, rows), pitch = operator.grid.shape, operator.beam.pixels, operator.grid.pitch
    if not 0 <= first < behind <= shape[2]:
        raise BadInput(f"slices are {slices!r}; expected 0 ≤ first < behind ≤ {shape[2]}")
    if (shape[2] - rows) % 2:
        raise BadInput(f"{rows} rows light {shape[2]} slices: each row lies between two slices; expected both numbers "
                       "even or both odd, or no slices")  # fmt: skip
    spreads = [operator.beam.sigma * pitch, *(tolerances.spread or () if tolerances is not None else ())]
    beyond = 2 * ceil(REACHED * max(spreads) / pitch)
    grid = Grid((*shape[:2], behind - first), pitch)
    beam = replace(operator.beam, pixels=(columns, behind - first + beyond))
    values = target.numpy() if hasattr(target, "numpy") else np.asarray(target)
    small = Projection(grid, beam, operator.motion, operator.vessel, operator.device)
    chosen = np.ascontiguousarray(values[:, :, first:behind], np.float32)
    if not (chosen >= 0.5).any():
        raise BadInput(f"no voxel of the part lies on slices {first} to {behind - 1}; expected slices that have some")
    return small, chosen

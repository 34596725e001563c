"""Methods compared with the same thresholds and the same number of projector evaluations."""

from __future__ import annotations

from typing import Any

from vamgpu.errors import BadInput
from vamgpu.losses.band import Band
from vamgpu.losses.response import Logistic
from vamgpu.methods.bclp import BCLP
from vamgpu.methods.calgd import GradientDescent
from vamgpu.methods.fbp import FilteredBackProjection
from vamgpu.methods.lbfgs import LBFGS
from vamgpu.methods.method import Method
from vamgpu.methods.osmo import OSMO
from vamgpu.methods.penalty import PenaltyMinimization
from vamgpu.methods.plan import Plan
from vamgpu.methods.recipe import Recipe
from vamgpu.methods.run import optimize
from vamgpu.methods.surface import SurfaceRamp
from vamgpu.operators.protocol import Operator

OUTSIDE, INSIDE = 0.78, 0.95  # thresholds for comparing methods, in units of the part's dose
LABELS = {
    "ramp": "surface ramp (default)",
    "lbfgs": "L-BFGS, two thresholds",
    "bclp": "BCLP",
    "penalty": "penalty minimization",
    "cal": "CAL gradient descent",
    "osmo": "OSMO",
    "recipe": "recipe",
    "fbp": "filtered back projection",
}
"""Names of methods in tables and plots, the default first."""


def at_thresholds(name: str, outside: float = OUTSIDE, inside: float = INSIDE) -> Method:
    """A method by its name in `LABELS`, set to the given thresholds in units of the part's dose. Raises `BadInput`."""
    # Methods of two thresholds take both. Those that fit a sigmoid have one threshold, its middle: the mean of the two.
    # The recipe has required doses instead, and filtered back projection has neither: both stay unchanged.
    Band.thresholds(outside, inside)
    middle = Logistic(middle=0.5 * (outside + inside))
    made: dict[str, Method] = {
        "ramp": SurfaceRamp(outside=outside, inside=inside, dark=min(SurfaceRamp.dark, outside)),
        "lbfgs": LBFGS(outside=outside, inside=inside),
        "bclp": BCLP(response=middle),
        "penalty": PenaltyMinimization(outside=outside, inside=inside),
        "cal": GradientDescent(response=middle),
        "osmo": OSMO(outside=outside, inside=inside),
        "recipe": Recipe(),
        "fbp": FilteredBackProjection(),
    }
    if name not in made:
        raise BadInput(f"no method {name!r} to compare; there are {', '.join(made)}")
    return made[name]


def compared(operator: Operator, target: Any, name: str, evaluations: float, *, resume: Plan | None = None) -> Plan:
    """The best patterns of a method, at `OUTSIDE` and `INSIDE`, after at most ``evaluations`` projector evaluations.

    Args:
        operator: The projector.
        target: A `Target`, or fractions [x, y, z].
        name: Name of the method, one of `LABELS`.
        evaluations: Most projector evaluations, warm start included; a method may use fewer.
        resume: A plan of the same call with fewer evaluations, to resume.

    Returns:
        The plan; it uses at most ``evaluations``, if they are enough for one iteration.

    Raises:
        BadInput: As `at_thresholds` and `optimize` do.
    """
    return optimize(operator, target, at_thresholds(name), evaluations=evaluations, resume=resume, progress=False)

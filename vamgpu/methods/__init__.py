"""Light for a target: every method through one `optimize(operator, target, method=…)`."""

from __future__ import annotations

from vamgpu.losses.response import GeneralizedLogistic, Interpolated, Linear, Logistic
from vamgpu.methods.bclp import BCLP
from vamgpu.methods.bounds import bound
from vamgpu.methods.calgd import GradientDescent
from vamgpu.methods.certificate import Bound
from vamgpu.methods.default import BestWindow
from vamgpu.methods.descent import Descent
from vamgpu.methods.fbp import FilteredBackProjection
from vamgpu.methods.lbfgs import LBFGS
from vamgpu.methods.osmo import OSMO
from vamgpu.methods.penalty import PenaltyMinimization
from vamgpu.methods.plan import Plan, Step
from vamgpu.methods.rebin import rebin
from vamgpu.methods.recipe import Recipe
from vamgpu.methods.run import METHODS, optimize
from vamgpu.methods.tolerances import Tolerances
from vamgpu.methods.tradeoff import ParetoPoint, pareto
from vamgpu.methods.widest import WidestWindow
from vamgpu.methods.window import ProcessWindow

__all__ = [
    "BCLP",
    "LBFGS",
    "METHODS",
    "OSMO",
    "BestWindow",
    "Bound",
    "Descent",
    "FilteredBackProjection",
    "GeneralizedLogistic",
    "GradientDescent",
    "Interpolated",
    "Linear",
    "Logistic",
    "PenaltyMinimization",
    "ParetoPoint",
    "Plan",
    "ProcessWindow",
    "Recipe",
    "Step",
    "Tolerances",
    "WidestWindow",
    "bound",
    "optimize",
    "pareto",
    "rebin",
]

"""Patterns for a target: every method is called through `optimize(operator, target, method=…)`."""

from __future__ import annotations

from vamgpu.losses.response import GeneralizedLogistic, Interpolated, Linear, Logistic
from vamgpu.methods.bclp import BCLP
from vamgpu.methods.bounds import bound
from vamgpu.methods.calgd import GradientDescent
from vamgpu.methods.certificate import Bound
from vamgpu.methods.choice import METHODS
from vamgpu.methods.descent import Descent
from vamgpu.methods.fbp import FilteredBackProjection
from vamgpu.methods.lbfgs import LBFGS
from vamgpu.methods.osmo import OSMO
from vamgpu.methods.penalty import PenaltyMinimization
from vamgpu.methods.plan import Plan, Step
from vamgpu.methods.rebin import rebin
from vamgpu.methods.recipe import Recipe
from vamgpu.methods.run import optimize
from vamgpu.methods.surface import SurfaceRamp
from vamgpu.methods.tolerances import Tolerances
from vamgpu.methods.tradeoff import ParetoPoint, pareto

__all__ = [
    "BCLP",
    "LBFGS",
    "METHODS",
    "OSMO",
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
    "Recipe",
    "Step",
    "SurfaceRamp",
    "Tolerances",
    "bound",
    "optimize",
    "pareto",
    "rebin",
]

"""Light for a target: every method through one `optimize(operator, target, method=…)`.

The package itself can be called like that function, so that ``vamgpu.optimize`` is both.
"""

from __future__ import annotations

import sys
from types import ModuleType
from typing import Any

from vamgpu.optimize.bclp import BCLP
from vamgpu.optimize.calgd import GradientDescent
from vamgpu.optimize.fbp import FilteredBackProjection
from vamgpu.optimize.lbfgs import LBFGS
from vamgpu.optimize.osmo import OSMO
from vamgpu.optimize.penalty import PenaltyMinimization
from vamgpu.optimize.plan import Plan, Step
from vamgpu.optimize.rebin import rebin
from vamgpu.optimize.recipe import Recipe
from vamgpu.optimize.response import GeneralizedLogistic, Interpolated, Linear, Logistic
from vamgpu.optimize.run import METHODS, optimize
from vamgpu.optimize.window import ProcessWindow

__all__ = [
    "BCLP",
    "LBFGS",
    "METHODS",
    "OSMO",
    "FilteredBackProjection",
    "GeneralizedLogistic",
    "GradientDescent",
    "Interpolated",
    "Linear",
    "Logistic",
    "PenaltyMinimization",
    "Plan",
    "ProcessWindow",
    "Recipe",
    "Step",
    "optimize",
    "rebin",
]


class _CallablePackage(ModuleType):
    """A package that is also the function it is named after."""

    def __call__(self, *args: Any, **options: Any) -> Plan:
        return optimize(*args, **options)


sys.modules[__name__].__class__ = _CallablePackage

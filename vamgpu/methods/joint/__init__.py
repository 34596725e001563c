"""Light of two colors optimized together, with the kinetics of photoinhibition turn by turn."""

from __future__ import annotations

from vamgpu.methods.dual.colors import Pair
from vamgpu.methods.joint.models import KineticModel, LinearModel, SpeciesFields
from vamgpu.methods.joint.resin import TwoColorResin
from vamgpu.methods.joint.run import ColorPlan, LossWeights, optimize_colors

__all__ = [
    "ColorPlan",
    "KineticModel",
    "LinearModel",
    "LossWeights",
    "Pair",
    "SpeciesFields",
    "TwoColorResin",
    "optimize_colors",
]

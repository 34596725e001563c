"""Light of two colors found together, through the kinetics of photoinhibition turn by turn."""

from __future__ import annotations

from vamgpu.optimize.joint.contrast import EffectiveContrast
from vamgpu.optimize.joint.models import KineticModel, LinearModel, Pair
from vamgpu.optimize.joint.poses import PoseRuns
from vamgpu.optimize.joint.resin import TwoColorResin
from vamgpu.optimize.joint.run import Aims, ColorPlan, optimize_colors

__all__ = [
    "Aims",
    "ColorPlan",
    "EffectiveContrast",
    "KineticModel",
    "LinearModel",
    "Pair",
    "PoseRuns",
    "TwoColorResin",
    "optimize_colors",
]

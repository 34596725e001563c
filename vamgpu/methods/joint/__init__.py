"""Light of two colors found together, through the kinetics of photoinhibition turn by turn."""

from __future__ import annotations

from vamgpu.methods.joint.contrast import EffectiveContrast
from vamgpu.methods.joint.models import KineticModel, LinearModel, Pair
from vamgpu.methods.joint.poses import PoseRuns
from vamgpu.methods.joint.resin import TwoColorResin
from vamgpu.methods.joint.run import Aims, ColorPlan, optimize_colors

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

"""Light of two colors found together, through the kinetics of photoinhibition turn by turn."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from vamgpu.deprecated import renamed
from vamgpu.methods.joint.contrast import EffectiveContrast
from vamgpu.methods.joint.models import KineticModel, LinearModel, Pair, SpeciesFields
from vamgpu.methods.joint.poses import PoseRuns
from vamgpu.methods.joint.resin import TwoColorResin
from vamgpu.methods.joint.run import ColorPlan, LossWeights, optimize_colors

__all__ = [
    "LossWeights",
    "ColorPlan",
    "EffectiveContrast",
    "KineticModel",
    "LinearModel",
    "Pair",
    "PoseRuns",
    "SpeciesFields",
    "TwoColorResin",
    "optimize_colors",
]

__getattr__: Callable[[str], Any] = renamed(__name__, {"Aims": "LossWeights"})

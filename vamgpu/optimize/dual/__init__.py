"""Light of two signs or two colors: exact dose subtraction, the rules SC, SC2 and DC, and least squares."""

from __future__ import annotations

from vamgpu.optimize.dual.colors import Colors, DualPlan, Pass
from vamgpu.optimize.dual.contrast import Contrast
from vamgpu.optimize.dual.exact import ExactPlan, Slice, reconstruct, sufficient
from vamgpu.optimize.dual.least import LeastSquares
from vamgpu.optimize.dual.passes import DualColor, SingleColor, Tolerant
from vamgpu.optimize.dual.points import PointProjection
from vamgpu.optimize.dual.run import METHODS, superpose

__all__ = [
    "METHODS",
    "Colors",
    "Contrast",
    "DualColor",
    "DualPlan",
    "ExactPlan",
    "LeastSquares",
    "Pass",
    "PointProjection",
    "SingleColor",
    "Slice",
    "Tolerant",
    "reconstruct",
    "sufficient",
    "superpose",
]

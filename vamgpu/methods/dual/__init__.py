"""Light of two signs or two colors: exact dose subtraction, the rules SC, SC2 and DC, and least squares."""

from __future__ import annotations

from vamgpu.methods.dual.colors import Colors, DualPlan, Pass
from vamgpu.methods.dual.contrast import Contrast
from vamgpu.methods.dual.exact import ExactPlan, Slice, reconstruct, sufficient
from vamgpu.methods.dual.least import LeastSquares
from vamgpu.methods.dual.passes import DualColor, SingleColor, Tolerant
from vamgpu.methods.dual.points import PointProjection
from vamgpu.methods.dual.run import METHODS, superpose

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

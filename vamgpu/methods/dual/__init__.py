"""Light of two colors: the rules SC, SC2 and DC, least squares, and the widest window."""

from __future__ import annotations

from vamgpu.methods.dual.colors import Colors, DualPlan, Pass
from vamgpu.methods.dual.least_squares import LeastSquares
from vamgpu.methods.dual.passes import DualColor, SingleColor, Tolerant
from vamgpu.methods.dual.run import METHODS, bound, superpose
from vamgpu.methods.dual.window import WidestWindow

__all__ = [
    "METHODS", "Colors", "DualColor", "DualPlan", "LeastSquares", "Pass", "SingleColor", "Tolerant", "WidestWindow",
    "bound", "superpose",
]  # fmt: skip

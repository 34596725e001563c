"""How good a dose is: pure functions of fields on any device, through the histogram kernels."""

from __future__ import annotations

from vamgpu.metrics.light import light_efficiency
from vamgpu.metrics.parts import Parts
from vamgpu.metrics.scores import Scores, score
from vamgpu.metrics.slices import SliceScores, score_slices

__all__ = ["Parts", "Scores", "SliceScores", "light_efficiency", "score", "score_slices"]

"""Scores of doses: pure functions of fields on any device, through the histogram kernels."""

from __future__ import annotations

from vamgpu.metrics.light import mean_brightness
from vamgpu.metrics.scores import Scores, score
from vamgpu.metrics.slices import SliceScores, score_slices

__all__ = ["Scores", "SliceScores", "mean_brightness", "score", "score_slices"]

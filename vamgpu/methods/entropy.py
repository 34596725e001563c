"""The loss whose gradient by dose is the error of a response itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.methods.band import Band
from vamgpu.methods.response import REACH, SAMPLES, Curve, Response
from vamgpu.methods.work import Work
from vamgpu.operators.reductions import dot, total

BELOW = 0.05
"""Dose of a level that the primitive never falls to where doses are a little negative, as ahead of light they are."""


class CrossEntropy:
    """Σ (1 − f)·P(d) + f·(P(d) − d − c), P = ∫₀ M, c the least of P(d) − d; its derivative by dose is M(d) − f.

    P is interpolated between its samples, so that M comes in steps: a logistic of steepness 10 to 0.4 %.

    For a logistic M of steepness s and a target of 0 and 1 this is the cross entropy of M(d) and f over s, less that of
    darkness out of the part. It is convex where M rises, and never negative. For M(d) = d it is half the square error.

    Args:
        work: Of the run; its target is f.
        response: M; beyond the doses it is sampled at it keeps its last value.
    """

    def __init__(self, work: Work, response: Response) -> None:
        curve, least = _primitive(response)
        self.band = Band((-BELOW, -BELOW), (0.0, 0.0), power=1.0, response=curve)
        part = work.volume()
        work.paint(0.0, part)
        self.constant = BELOW * work.voxels + least * total(part)
        # a target that stays within the cylinder needs no copy that does
        self.part = work.target if dot(part, part) == dot(work.target, work.target) else part

    def __call__(self, work: Work, dose: DeviceArray) -> float:
        """The loss of a dose [x, y, z], which becomes the gradient."""
        asked = dot(self.part, dose)
        found = work.loss(dose, self.band)
        work.combine(1.0, dose, -1.0, self.part, dose)
        return found - asked - self.constant


@dataclass(frozen=True, eq=False)
class _Sampled:
    """A response that is known by its samples."""

    samples: Curve

    def curve(self) -> Curve:
        return self.samples


def _primitive(response: Response) -> tuple[_Sampled, float]:
    """P, and c."""
    curve = response.curve()
    doses = np.linspace(0.0, REACH, SAMPLES)
    at = (doses - curve.start) * curve.density
    cell = np.clip(at.astype(int), 0, len(curve.values) - 2)
    values = curve.values[cell] + (at - cell) * (curve.values[cell + 1] - curve.values[cell])
    primitive = np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * doses[1])])
    return _Sampled(Curve(primitive, 0.0, (SAMPLES - 1) / REACH)), float((primitive - doses).min())

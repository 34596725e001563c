"""Filtered back projection: exact for light that may be negative, and clipped at 0."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from vamgpu.backend.array import DeviceArray
from vamgpu.losses.band import Band
from vamgpu.methods.method import Criterion, Method, Steps
from vamgpu.methods.papers import RAMP
from vamgpu.methods.quadrature import check_complete
from vamgpu.methods.ramp import ramp
from vamgpu.methods.state import OptimizerState


@dataclass(frozen=True)
class FilteredBackProjection(Method):
    """Forward projection, ramp filter, clipping: a single projector evaluation.

    Angles are weighted by the range of directions that they represent. `optimize` rejects a scan that lacks a twentieth
    of all directions, because it cannot be inverted; iterative methods accept it.
    """

    papers: ClassVar[tuple[str, ...]] = (RAMP,)
    iterations: ClassVar[int] = 1
    criterion: ClassVar[Criterion] = "window"
    takes_weights: ClassVar[bool] = False

    def steps(self, state: OptimizerState) -> Steps:
        check_complete(state.operator.motion)
        dose = state.volume()
        filtered_light(state, dose)
        window, _ = state.window(dose)
        yield state.loss(dose, Band((0.0, 1.0), (0.0, 0.0))), window


def filtered_light(state: OptimizerState, dose: DeviceArray) -> float:
    """Put the target's filtered and clipped projection, scaled to a mean dose of one, into memory as ``light``."""
    projected, light = state.sinogram(), state.sinogram()
    state.project_scaled(state.target, projected)
    state.filter(projected, ramp(state.operator), light, floor=0.0)
    state.expose(light, dose)
    gain = state.part_mean(dose)
    state.scale(1.0 / gain, light, light)
    state.scale(1.0 / gain, dose, dose)
    state.memory["light"] = light
    return gain

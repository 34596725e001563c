"""Filtered back projection: exact for light that may be negative, clipped because it may not."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from vamgpu.backend.array import DeviceArray
from vamgpu.losses.band import Band
from vamgpu.methods.method import Criterion, Steps
from vamgpu.methods.papers import RAMP
from vamgpu.methods.quadrature import check_complete
from vamgpu.methods.ramp import ramp
from vamgpu.methods.work import Work


@dataclass(frozen=True)
class FilteredBackProjection:
    """Forward projection, ramp, clip: one projector pair and done.

    Poses count by the directions that they stand for. `optimize` refuses a scan that lacks a twentieth of all
    directions, where nothing is inverted: methods that iterate take it.
    """

    papers: ClassVar[tuple[str, ...]] = (RAMP,)
    iterations: ClassVar[int] = 1
    cost: ClassVar[float] = 1.0
    criterion: ClassVar[Criterion] = "window"

    def steps(self, work: Work) -> Steps:
        check_complete(work.operator.motion)
        dose = work.volume()
        filtered_light(work, dose)
        window, _ = work.window(dose)
        yield work.loss(dose, Band((0.0, 1.0), (0.0, 0.0))), window


def filtered_light(work: Work, dose: DeviceArray) -> None:
    """Put the clipped, filtered projection of the target into memory as ``light``, and its dose into ``dose``.

    Scaled so that the part's mean dose is one; one projector pair.
    """
    shadow, light = work.sinogram(), work.sinogram()
    work.project(work.target, shadow)
    work.filter(shadow, ramp(work.operator), light, floor=0.0)
    work.expose(light, dose)
    gain = work.part_mean(dose)
    work.scale(1.0 / gain, light, light)
    work.scale(1.0 / gain, dose, dose)
    work.memory["light"] = light

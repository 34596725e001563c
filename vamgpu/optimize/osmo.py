"""Object-space model optimization."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from vamgpu.backend.array import DeviceArray
from vamgpu.errors import BadInput
from vamgpu.kernels.update import correct_by_difference
from vamgpu.optimize.band import Band
from vamgpu.optimize.method import Steps
from vamgpu.optimize.papers import OBJECT_SPACE
from vamgpu.optimize.ramp import Taps, ramp
from vamgpu.optimize.work import Work


@dataclass(frozen=True)
class OSMO:
    """Lower a model of the part where voids get too much and raise it where the part gets too little, in turn.

    Light is the filtered, clipped projection of the model; doses are over their maximum. One iteration corrects voids,
    projects, corrects the part, projects: two projector pairs.

    outside, inside: thresholds over the greatest dose.  gain: share of a difference that is corrected.
    Raises `BadInput`.
    """

    outside: float = 0.6
    inside: float = 0.85
    gain: float = 1.0
    papers: ClassVar[tuple[str, ...]] = (OBJECT_SPACE,)
    iterations: ClassVar[int] = 20

    def __post_init__(self) -> None:
        Band.thresholds(self.outside, self.inside)
        if not self.gain > 0:
            raise BadInput(f"{self!r}: wanted gain > 0")

    def steps(self, work: Work) -> Steps:
        dose, shadow, taps = work.volume(), work.sinogram(), ramp(work.operator)
        if "light" not in work.memory:
            work.memory["light"], model = work.sinogram(), work.volume()
            work.paint(0.0, model)
            self._illuminate(work, model, shadow, taps, dose)
            self._correct(work, dose, model, void=True)
            work.memory["model"] = model
        model, light = work.held("model"), work.held("light")
        band = Band.thresholds(self.outside, self.inside)
        while True:
            self._illuminate(work, model, shadow, taps, dose)
            self._correct(work, dose, model, void=False)
            window = self._illuminate(work, model, shadow, taps, dose)
            self._correct(work, dose, model, void=True)
            work.scale(1.0 / work.number("peak"), light, light)
            work.scale(1.0 / work.number("peak"), dose, dose)
            yield work.loss(dose, band), window

    def _illuminate(self, work: Work, model: DeviceArray, shadow: DeviceArray, taps: Taps, dose: DeviceArray) -> float:
        """Light for a model, and its dose; returns the window."""
        work.project(model, shadow)
        work.filter(shadow, taps, work.held("light"), floor=0.0)
        work.expose(work.held("light"), dose)
        window, work.memory["peak"] = work.window(dose)
        return window

    def _correct(self, work: Work, dose: DeviceArray, model: DeviceArray, *, void: bool) -> None:
        work.device.launch(
            correct_by_difference,
            dose=dose,
            scale=1.0 / work.number("peak"),
            target=work.target,
            low=self.outside,
            high=self.inside,
            gain_outside=self.gain * void,
            gain_inside=self.gain * (not void),
            reach=work.reach,
            model=model,
        )

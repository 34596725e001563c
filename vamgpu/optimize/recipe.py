"""The recipe of automatic exposure: filter, clip, and correct the target by the dose it gave."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from vamgpu.backend.array import DeviceArray
from vamgpu.errors import BadInput
from vamgpu.kernels.update import correct_by_ratio
from vamgpu.optimize.band import Band
from vamgpu.optimize.method import Steps
from vamgpu.optimize.papers import AUTOMATIC_EXPOSURE, RAMP
from vamgpu.optimize.ramp import ramp
from vamgpu.optimize.work import Work


@dataclass(frozen=True)
class Recipe:
    """Filtered back projection of a target over a background, corrected multiplicatively after each pass.

    One iteration is one pass and one projector pair. The paper's pre-compensation of diffusion is left to the target,
    its correction for the vial to `rebin`; a vessel in the operator needs none.

    background: dose wanted around the part over that of the part,
    room for light that should be negative.  most: largest correction of a voxel in one pass.  Raises `BadInput`.
    """

    background: float = 0.6
    most: float = 10.0
    papers: ClassVar[tuple[str, ...]] = (AUTOMATIC_EXPOSURE, RAMP)
    iterations: ClassVar[int] = 2

    def __post_init__(self) -> None:
        if not 0.0 <= self.background < 1.0 or not self.most > 1.0:
            raise BadInput(f"{self!r}: wanted 0 ≤ background < 1 and most > 1")

    def steps(self, work: Work) -> Steps:
        if "light" not in work.memory:
            work.memory["light"], model = work.sinogram(), work.volume()
            work.paint(self.background, model)
            work.memory["model"] = model
        dose, shadow, filtered = work.volume(), work.sinogram(), ramp(work.operator)
        light, model = work.held("light"), work.held("model")
        band = Band((self.background, 1.0), (0.0, 0.0))
        while True:
            work.project(model, shadow)
            work.filter(shadow, filtered, light, floor=0.0)
            work.expose(light, dose)
            gain = work.part_mean(dose)
            work.scale(1.0 / gain, light, light)
            work.scale(1.0 / gain, dose, dose)
            window, _ = work.window(dose)
            self._correct(work, dose, model)
            work.memory["gain"] = gain
            yield work.loss(dose, band), window

    def _correct(self, work: Work, dose: DeviceArray, model: DeviceArray) -> None:
        bands = {"low": self.background, "high": 1.0, "most": self.most}
        work.device.launch(correct_by_ratio, dose=dose, scale=1.0, target=work.target, **bands, model=model)

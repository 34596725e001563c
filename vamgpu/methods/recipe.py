"""The recipe of automatic exposure: filter, clip, and correct the target by the dose it gave."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from vamgpu.backend.array import DeviceArray
from vamgpu.chemistry.diffusion import Diffusion, Spread
from vamgpu.chemistry.precompensate import contrast
from vamgpu.errors import BadInput
from vamgpu.kernels.update import correct_by_ratio, paint
from vamgpu.losses.band import Band
from vamgpu.methods.method import Criterion, Steps
from vamgpu.methods.papers import AUTOMATIC_EXPOSURE, RAMP
from vamgpu.methods.ramp import ramp
from vamgpu.methods.work import Work


@dataclass(frozen=True)
class Recipe:
    """Filtered back projection of a target over a background, corrected multiplicatively after each pass.

    One iteration is one pass and one projector pair. The paper's correction for the vial is left to `rebin`; a vessel
    in the operator needs none.

    background: dose wanted around the part over that of the part, room for light that should be negative.
    most: largest correction of a voxel in one pass.  diffusion: of oxygen during the exposure; the target over its
    background is then deconvolved by it before the first pass, and what is corrected and judged is the dose after
    diffusion (a plan's own window stays that of the light alone). Light that is never negative need not reach what is
    deconvolved, so a print need not come out better: compare both.  Raises `BadInput`.
    """

    background: float = 0.6
    most: float = 10.0
    diffusion: Diffusion | None = None
    papers: ClassVar[tuple[str, ...]] = (AUTOMATIC_EXPOSURE, RAMP)
    iterations: ClassVar[int] = 2
    cost: ClassVar[float] = 1.0
    criterion: ClassVar[Criterion] = "window"

    def __post_init__(self) -> None:
        if not 0.0 <= self.background < 1.0 or not self.most > 1.0:
            raise BadInput(f"{self!r}: wanted 0 ≤ background < 1 and most > 1")

    def steps(self, work: Work) -> Steps:
        spread = None if self.diffusion is None else Spread(work.operator.grid, self.diffusion, work.device)
        if "light" not in work.memory:
            work.memory["light"], work.memory["model"] = work.sinogram(), self._model(work, spread)
        dose, shadow, filtered = work.volume(), work.sinogram(), ramp(work.operator)
        felt = dose if spread is None else work.volume()
        light, model = work.held("light"), work.held("model")
        band = Band((self.background, 1.0), (0.0, 0.0))
        while True:
            work.project(model, shadow)
            work.filter(shadow, filtered, light, floor=0.0)
            work.expose(light, dose)
            if spread is not None:
                spread(dose, out=felt)
            gain = work.part_mean(felt)
            work.scale(1.0 / gain, light, light)
            work.scale(1.0 / gain, felt, felt)
            window, _ = work.window(felt)
            self._correct(work, felt, model)
            work.memory["gain"] = gain
            loss = work.loss(felt, band)
            work.offer(loss, window, 1)
            yield loss, window

    def _model(self, work: Work, spread: Spread | None) -> DeviceArray:
        """The target over its background, deconvolved where it will diffuse."""
        model = work.volume()
        goal = work.target if spread is None else contrast(spread, work.target, self.background)
        levels = {"low": self.background, "high": 1.0, "reach": work.reach}
        work.device.launch(paint, target=goal, **levels, model=model)
        return model

    def _correct(self, work: Work, dose: DeviceArray, model: DeviceArray) -> None:
        bands = {"low": self.background, "high": 1.0, "most": self.most}
        work.device.launch(correct_by_ratio, dose=dose, scale=1.0, target=work.target, **bands, model=model)

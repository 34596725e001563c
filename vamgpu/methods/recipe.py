"""The recipe of automatic exposure: filter, clip, and correct the target by its dose."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from vamgpu.backend.array import DeviceArray
from vamgpu.chemistry.diffusion import Diffusion, Spread
from vamgpu.chemistry.precompensate import contrast
from vamgpu.errors import BadInput
from vamgpu.kernels.update import correct_by_ratio, fill_background
from vamgpu.losses.band import Band
from vamgpu.methods.method import Criterion, Method, Steps
from vamgpu.methods.papers import AUTOMATIC_EXPOSURE, RAMP
from vamgpu.methods.ramp import ramp
from vamgpu.methods.state import OptimizerState


@dataclass(frozen=True)
class Recipe(Method):
    """Filtered back projection of a target over a background, corrected multiplicatively after each pass.

    One iteration is one pass and one projector evaluation. The paper's correction for the vial is separate (`rebin`);
    an operator with a vessel does not need it.

    Args:
        background: Expected dose around the part, relative to that of the part; it avoids negative light.
        most: Largest correction of a voxel in one pass.
        diffusion: Diffusion of oxygen during the exposure. The target with its background is deconvolved before the
            first pass, and the dose after diffusion is corrected and judged (the plan's own window ignores diffusion).
            Light cannot be negative and may not reach the deconvolved target; the print is therefore not always better:
            compare both.

    Raises:
        BadInput: A value is out of its range.
    """

    background: float = 0.6
    most: float = 10.0
    diffusion: Diffusion | None = None
    papers: ClassVar[tuple[str, ...]] = (AUTOMATIC_EXPOSURE, RAMP)
    iterations: ClassVar[int] = 2
    criterion: ClassVar[Criterion] = "window"
    takes_weights: ClassVar[bool] = False

    def __post_init__(self) -> None:
        if not 0.0 <= self.background < 1.0 or not self.most > 1.0:
            raise BadInput(f"{self!r}: expected 0 ≤ background < 1 and most > 1")

    def steps(self, state: OptimizerState) -> Steps:
        spread = None if self.diffusion is None else Spread(state.operator.grid, self.diffusion, state.device)
        if "light" not in state.memory:
            state.memory["light"], state.memory["model"] = state.sinogram(), self._model(state, spread)
        dose, projected, filtered = state.volume(), state.sinogram(), ramp(state.operator)
        felt = dose if spread is None else state.volume()
        light, model = state.buffer("light"), state.buffer("model")
        band = Band((self.background, 1.0), (0.0, 0.0))
        while True:
            state.project_scaled(model, projected)
            state.filter(projected, filtered, light, floor=0.0)
            state.expose(light, dose)
            if spread is not None:
                spread(dose, out=felt)
            gain = state.part_mean(felt)
            state.scale(1.0 / gain, light, light)
            state.scale(1.0 / gain, felt, felt)
            window, _ = state.window(felt)
            bands = {"low": self.background, "high": 1.0, "most": self.most}
            state.device.launch(correct_by_ratio, dose=felt, scale=1.0, target=state.target, **bands, model=model)
            state.memory["gain"] = gain
            loss = state.loss(felt, band)
            state.offer(loss, window, 1)
            yield loss, window

    def _model(self, state: OptimizerState, spread: Spread | None) -> DeviceArray:
        """The target plus its background, deconvolved if the dose diffuses."""
        model = state.volume()
        goal = state.target if spread is None else contrast(spread, state.target, self.background)
        levels = {"low": self.background, "high": 1.0, "reach": state.reach}
        state.device.launch(fill_background, target=goal, **levels, model=model)
        return model

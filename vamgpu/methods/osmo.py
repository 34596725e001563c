"""Object-space model optimization."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from vamgpu.backend.array import DeviceArray
from vamgpu.errors import BadInput
from vamgpu.kernels.update import correct_by_difference
from vamgpu.losses.band import MOST, Band
from vamgpu.methods.method import Criterion, Method, Steps
from vamgpu.methods.papers import OBJECT_SPACE
from vamgpu.methods.ramp import Taps, ramp
from vamgpu.methods.state import OptimizerState


@dataclass(frozen=True)
class OSMO(Method):
    """Alternately lower a model of the part where voids get too much dose, and raise it where the part gets too little.

    As published: the model m begins as the target, and d is the dose of its light, divided by the greatest dose:

        m ← m − max(0, d − outside) in voids, update d, then m ← m + max(0, inside − d) in the part, update d

    The light of the model is never negative: max(0, filter(A m)). One iteration takes two projector evaluations; the
    first iteration takes a third one, for the dose of the target itself.

    What differs here: the ramp filters every projection of the model, and corrections are therefore sharpened like the
    target (the authors' toolbox filters only the target); ``gain`` scales a correction (published: 1).

    Args:
        outside: Threshold of voids, relative to the greatest dose.
        inside: Threshold of the part, relative to the greatest dose.
        gain: Share of a difference that is corrected, > 0.

    Raises:
        BadInput: The gain is not positive, or the thresholds are not 0 ≤ outside < inside ≤ 1.
    """

    outside: float = 0.6
    inside: float = 0.85
    gain: float = 1.0
    papers: ClassVar[tuple[str, ...]] = (OBJECT_SPACE,)
    iterations: ClassVar[int] = 20
    cost: ClassVar[float] = 2.0
    criterion: ClassVar[Criterion] = "window"
    takes_weights: ClassVar[bool] = False

    def __post_init__(self) -> None:
        Band.thresholds(self.outside, self.inside)
        if not 0 < self.gain < MOST:
            raise BadInput(f"{self!r}: expected 0 < gain < {MOST:g}")

    def steps(self, state: OptimizerState) -> Steps:
        dose, projected, taps = state.volume(), state.sinogram(), ramp(state.operator)
        if "light" not in state.memory:
            state.memory["light"], model = state.sinogram(), state.volume()
            state.fill_background(0.0, model)
            self._illuminate(state, model, projected, taps, dose)
            self._correct(state, dose, model, void=True)
            state.memory["model"] = model
        model, light = state.buffer("model"), state.buffer("light")
        band = Band.thresholds(self.outside, self.inside)
        while True:
            self._illuminate(state, model, projected, taps, dose)
            self._correct(state, dose, model, void=False)
            window = self._illuminate(state, model, projected, taps, dose)
            self._correct(state, dose, model, void=True)
            state.scale(1.0 / state.number("peak"), light, light)
            state.scale(1.0 / state.number("peak"), dose, dose)
            loss = state.loss(dose, band)
            state.offer(loss, window, 1)
            yield loss, window

    def _illuminate(
        self, state: OptimizerState, model: DeviceArray, projected: DeviceArray, taps: Taps, dose: DeviceArray
    ) -> float:
        """Light for a model, and its dose; returns the window."""
        state.project_scaled(model, projected)
        state.filter(projected, taps, state.buffer("light"), floor=0.0)
        state.expose(state.buffer("light"), dose)
        window, state.memory["peak"] = state.window(dose)
        return window

    def _correct(self, state: OptimizerState, dose: DeviceArray, model: DeviceArray, *, void: bool) -> None:
        state.device.launch(
            correct_by_difference,
            dose=dose,
            scale=1.0 / state.number("peak"),
            target=state.target,
            low=self.outside,
            high=self.inside,
            gain_outside=self.gain * void,
            gain_inside=self.gain * (not void),
            reach=state.reach,
            model=model,
        )

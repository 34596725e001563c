"""The widest window of two colors: levels and light of both, found together."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar, cast, final

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.chemistry.species import PAPER
from vamgpu.errors import BadInput, EmptyMesh
from vamgpu.geometry import Turntable
from vamgpu.kernels.inhibition import put_poses, take_poses
from vamgpu.losses.band import Band
from vamgpu.losses.loss import Loss
from vamgpu.methods.dual.colors import Pair, Pass
from vamgpu.methods.dual.passes import DualState, Rule
from vamgpu.methods.exposure import lower
from vamgpu.methods.fbp import filtered_light
from vamgpu.methods.minimize import StepRule
from vamgpu.methods.papers import LIMITED_MEMORY
from vamgpu.methods.state import OptimizerState
from vamgpu.methods.two_levels import found_levels
from vamgpu.operators.compose import Derived, combine, inherit
from vamgpu.operators.reductions import EVERYWHERE, extent
from vamgpu.operators.space import SinogramSpace

LACKS = (0.1, 0.03, 0.01, 0.003, 0.001, 0.0003, 0.0001)
"""Dose that the part lacks in all, divided by its number of voxels, in successive rounds."""
PAIRS = 10  # number of pairs of the quasi-Newton method


@final
class BothColors(Derived):
    """Dose of two colors, the light of which follows each other: first the visible light of all angles, then the UV."""

    def __init__(self, visible: Any, model: Any, units: tuple[float, float] = (1.0, 1.0), top: float = 1.0) -> None:
        inherit(self, visible)
        self.model: Any = model  # gives the dose of light of both colors, and its derivatives
        self.units: tuple[float, float] = units  # light of the model for light of 1, of each color
        self.top: float = top  # dose of the model that counts as 1
        self.angles: int = visible.range.shape[0]
        self.motion: Turntable = Turntable(2 * self.angles)
        self._set_spaces(visible.domain, SinogramSpace(visible.beam, self.motion), visible.device)
        self.signs: np.ndarray = np.ones(self.range.shape, np.float32)  # −1 for light that subtracts dose
        self.signs[self.angles :] = -1.0

    def __repr__(self) -> str:
        return f"BothColors({self.model!r})"

    def forward(self, x: DeviceArray, out: DeviceArray) -> None:
        slopes = self.model.gradient(x)
        for part, unit in zip(slopes, self.units, strict=True):
            combine(unit / self.top, part, 0.0, part, part)
        self.join(slopes, out)

    def transposed(self, y: DeviceArray, out: DeviceArray) -> None:
        dose = self.model.expose(self.split(y))
        combine(1.0 / self.top, dose, 0.0, dose, out)

    def split(self, light: DeviceArray) -> Pair:
        """Light of each color, for the model."""
        parts = [self.device.empty((self.angles, *self.range.shape[1:])) for _ in range(2)]
        for number, (part, unit) in enumerate(zip(parts, self.units, strict=True)):
            self.device.launch(take_poses, light=light, first=number * self.angles, part=part)
            combine(unit, part, 0.0, part, part)
        return Pair(*parts)

    def join(self, light: Pair, out: DeviceArray) -> DeviceArray:
        """Light of both colors, in out."""
        for number, part in enumerate(light):
            self.device.launch(put_poses, part=part, first=number * self.angles, light=out)
        return out


class WindowLoss(Loss):
    """b − a + Σ e² / (2·lack) at the best levels; e: dose below a or above 1 in the part, above b outside, or 0."""

    opposite: DeviceArray  # −1 times the last dose

    def __init__(self, lack: float) -> None:
        self.lack: float = lack
        self.least: float = 1.0
        self.leak: float = 0.0

    def value_and_gradient(
        self, dose: DeviceArray, target: DeviceArray, out: DeviceArray, reach: float = EVERYWHERE
    ) -> float:
        self.opposite = combine(-1.0, dose, 0.0, dose, dose.device.empty(dose.shape))
        point = {"held": dose, "scaled_dual": self.opposite, "target": target, "reach": reach, "rim": 0.0}
        self.least, leak = found_levels(point | {"least": self.least, "leak": self.leak}, self.lack)
        self.leak = max(leak, 0.0)
        deep, half = 1.0 + max(0.0, self.leak - extent(dose, reach=reach)[0]), 0.5 / self.lack
        center, slack = (self.leak - deep, 0.5 * (1.0 + self.least)), (deep, 0.5 * (1.0 - self.least))
        band = Band(center, slack, (half, half), binary=True)
        return self.leak - self.least + band.value_and_gradient(dose, target, out, reach)


def widened(run: OptimizerState, evaluations: int, relative: bool = True) -> Iterator[DeviceArray | None]:
    """Widen the window of ``light`` by `WindowLoss`, whose lack falls; yields −1 times better light's dose, or None."""
    part = float(np.count_nonzero(run.evaluation_mask() * run.target.numpy() >= 0.5))
    if not part:
        raise EmptyMesh("no judged voxel is filled to half; use smaller voxels or thicker walls")
    for number, share in enumerate(LACKS):
        run.most_evaluations = evaluations * (number + 1) / len(LACKS)
        run.memory.pop("loss", None)
        loss = WindowLoss(share * part)
        for value, window in lower(run, loss, StepRule(history=PAIRS)):
            run.iteration += 1
            window *= 1.0 if relative else min(1.0, -extent(loss.opposite, reach=run.reach)[0])
            yield loss.opposite if run.offer(value, window, 0) else None
            if not run.affords(1.0):
                break


@dataclass(frozen=True)
class WidestWindow(Rule):
    """Maximize least dose in the part − greatest dose outside, of doses of at most 1, over the light of both colors.

    L-BFGS finds levels and light together, from the squares of doses beyond their levels. Negative dose counts as 0.

    Args:
        iterations: Number of projector evaluations of both colors.

    Raises:
        BadInput: The number is below 1.
    """

    iterations: int = 400
    papers: ClassVar[tuple[str, ...]] = (PAPER, LIMITED_MEMORY)

    def __post_init__(self) -> None:
        if self.iterations < 1:
            raise BadInput(f"{self!r}: expected iterations ≥ 1")

    def steps(self, state: DualState) -> Iterator[Pass]:
        both = BothColors(state.colors.visible, state.colors)
        run = OptimizerState(cast(Any, both), state.target, {"light": self._start(state, both)})
        run.reach = EVERYWHERE if state.colors.whole else run.reach
        dose, under, over = (state.volume() for _ in range(3))
        for better in widened(run, self.iterations):
            state.evaluations = 2.0 * run.evaluations
            if better is not None:
                state.light, state.uv = light = both.split(run.buffer("best"))
                scale = -state.greatest(state.target) / extent(better)[0]
                combine(-scale, better, 0.0, better, dose, floor=0.0)
                for field in light:
                    state.scale(scale, field, field)
            yield state.compare(dose, state.target, under, over)

    def _start(self, state: DualState, both: BothColors) -> DeviceArray:
        """Filtered visible light, and no UV."""
        visible = OptimizerState(cast(Any, state.colors.visible), state.target, {})
        filtered_light(visible, visible.volume())
        light = both.device.upload(np.zeros(both.range.shape, np.float32))
        both.device.launch(put_poses, part=visible.buffer("light"), first=0, light=light)
        return light

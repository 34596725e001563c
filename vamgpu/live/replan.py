"""The light of the turns that remain, for what the turns so far delivered."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import inf, isfinite, prod
from typing import Any

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.geometry import positive
from vamgpu.kernels.update import correct_by_ratio
from vamgpu.live.border import Border
from vamgpu.live.planes import by_planes
from vamgpu.losses.band import Band
from vamgpu.losses.loss import Loss
from vamgpu.methods.exposure import DoseObjective
from vamgpu.methods.minimize import Channel, Pace, minimize
from vamgpu.methods.part import fractions_of, one_limit
from vamgpu.methods.projector import Projector
from vamgpu.methods.ramp import capped_ramp
from vamgpu.methods.state import OptimizerState
from vamgpu.methods.window import SPAN
from vamgpu.metrics import score
from vamgpu.operators.compose import capped, combine
from vamgpu.operators.reductions import dot, extent, total
from vamgpu.operators.space import require

SURE = 2.0
"""Standard deviations by which a voxel must be over its limit to be given up."""
LITTLE = 0.02
"""Dose of the first light looked at where the part has its dose already, for the sake of voxels that have not."""
CAP = 0.25
"""Frequency [cycles per column] beyond which the preconditioner is level."""
ROUNDING = 1e-6
"""Share by which light may seem to exceed a bound."""
RATIO = 5.0
"""By which a pixel of the plan is brightened at most for the dose that is wanted."""
FORMED = 1.0
"""Distance from the part's [voxels] within which a surface must lie where a print may stop."""
WORTH = 0.02
"""By which further turns must bring the surface nearer to the part's [voxels]."""


def finite(space: Any, values: Any, device: Device, name: str) -> DeviceArray:
    """Values on the device. Raises `BadInput` for what is no number, `ShapeMismatch`."""
    require(space, values, name)
    known = isfinite(total(values)) if isinstance(values, DeviceArray) else np.isfinite(values).all()
    if not known:
        raise BadInput(f"{name} holds NaN or infinity; expected finite numbers: go on by the last plan")
    return device.field(values)


@dataclass(frozen=True)
class Outlook:
    """What a print is expected to be.

    Args:
        turns: From now on.
        window: Strict process window, dimensionless.
        iou: Overlap with the part at the threshold of the resin, dimensionless, 0..1.
    """

    turns: int
    window: float
    iou: float


@dataclass(frozen=True, eq=False)
class Replanned:
    """Light of each of the turns that remain.

    Args:
        light: Of one turn, [angle, r, z] on the device, 0 to the projector's bound; dark where the print should stop.
        kept: What the plan that was running would make of the print.
        expected: What this light makes of it; its ``turns`` is the moment to stop.
        evaluations: Projector evaluations spent; a replay that may spend as many finds the same light.
    """

    light: DeviceArray
    kept: Outlook
    expected: Outlook
    evaluations: float


@dataclass(frozen=True, eq=False)
class Replanner:
    """Optimizes the light of the turns that remain; all of them show the same.

    The delivered dose enters the loss as an offset. Voxels that are surely over their limit (void that is already
    printed, part above ``most``) cannot be mended and get no weight. How much of the light is given, and whether any
    is, is decided by where the surface of the print will lie.

    Args:
        target: A `Target`, or fractions [x, y, z].
        most: Greatest light of a pixel, in units of the plan's.
        outside: Greatest dose outside the part, in units of the part's dose.
        inside: Least dose in the part.
        greatest: Greatest dose in the part.
        threshold: Dose from which resin is solid, to which the three before are scaled, so that it is in the middle
            between outside and inside; None for where it is.

    Raises:
        BadInput: A value is out of its range.
    """

    target: Any
    most: float
    outside: float = 0.78
    inside: float = 0.95
    greatest: float = 1.0
    threshold: float | None = None
    _known: dict[Any, tuple[DeviceArray, Border]] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        positive("greatest light", self.most)
        Band.thresholds(self.outside, self.inside, self.greatest)
        middle = 0.5 * (self.outside + self.inside)
        share = 1.0 if self.threshold is None else positive("threshold", self.threshold) / middle
        for name in ("outside", "inside", "greatest"):
            object.__setattr__(self, name, share * getattr(self, name))
        object.__setattr__(self, "threshold", share * middle)

    def replan(
        self, operator: Projector, delivered: Any, plan: Any, planned: int, turns: Sequence[int], *,
        evaluations: float, deviation: Any = 0.0, wanted: Any = None,
    ) -> Replanned:  # fmt: skip
        """Light for the rest of a print, the best found with what may be spent.

        Args:
            operator: As estimated, e.g. `Estimator.delivering`.
            delivered: Dose so far, [x, y, z].
            plan: Light of each turn that would be shown otherwise, [angle, r, z].
            planned: Turns it would be shown for.
            turns: Numbers of further turns that are allowed, 0 for a stop now.
            evaluations: Projector evaluations that may be spent; seconds times those a machine makes in one.
            deviation: Standard deviation of the delivered dose, [x, y, z], or one for all.
            wanted: Dose that the whole print was meant to have, [x, y, z]; the plan's light is first corrected by
                what is left of it. None to begin with the plan as it is.

        Returns:
            The light found, or the plan's own where its surface lies no farther off.

        Raises:
            BadInput: A dose or light that is no number, or no turns.
            ShapeMismatch: An array of another geometry.
        """
        counts = sorted({int(count) for count in turns})
        if not counts or counts[0] < 0 or planned < 0:
            raise BadInput(f"got turns {list(turns)} and {planned} planned; expected whole numbers from 0 on")
        target, border = self._part(operator)
        state = OptimizerState(operator, target, {}, "loss")  # type: ignore[arg-type]
        state.most_evaluations = positive("evaluations", evaluations)
        device = operator.device
        given = finite(operator.domain, delivered, device, "the delivered dose")
        light = finite(operator.range, plan, device, "the plan's light")
        loss = self._loss(np.asarray(delivered), border.part, deviation).on(state.field)
        dose, work = state.volume(), state.volume()

        state.expose(light, dose)
        mean = state.part_mean(dose)
        state.combine(1.0, given, float(planned), dose, work)
        kept, kept_off = self._outlook(planned, work, target, state), border.off(work)
        possible = extent(light)[1] <= self.most * (1.0 + ROUNDING) and planned in counts

        best, best_off, expected = None, inf, kept
        if counts[-1]:
            missing = max(0.5 * (self.inside + self.greatest) - state.part_mean(given), LITTLE) / mean
            begin = state.memory["light"] = state.sinogram()
            state.scale(missing, light, begin)
            fewest = self._turns(begin, counts)
            if wanted is not None and state.affords(1.0 + 0.5):
                self._corrected(state, begin, missing, dose, given, finite(operator.domain, wanted, device,
                                "the wanted dose"))  # fmt: skip
            capped(begin, fewest * self.most)
            best = self._lowered(state, loss, given, fewest)
            state.expose(best, dose)
            share = min(border.share(given, dose), counts[-1] * self.most / max(extent(best)[1], 1e-30))
            state.scale(share, best, best)
            state.combine(1.0, given, share, dose, work)
            needed = self._turns(best, counts)
            expected, best_off = self._outlook(needed, work, target, state), border.off(work)
        off = border.off(given)
        if counts[0] == 0 and off <= min(FORMED, min(best_off, kept_off if possible else inf) + WORTH):
            dark = state.device.upload(np.zeros(light.shape, np.float32))
            return Replanned(dark, kept, self._outlook(0, given, target, state), state.evaluations)
        if best is None or (possible and kept_off <= best_off):
            return Replanned(light, kept, kept, state.evaluations)
        state.scale(1.0 / expected.turns, best, best)
        return Replanned(best, kept, expected, state.evaluations)

    def _part(self, operator: Projector) -> tuple[DeviceArray, Border]:
        """The part on an operator's device, and its border: found once, however often the operator is clouded."""
        place = operator.device, operator.domain
        if place not in self._known:
            target = fractions_of(operator, one_limit(self.target))
            self._known[place] = target, Border(target.numpy(), self.threshold or 0.0)
        return self._known[place]

    def _turns(self, light: DeviceArray, counts: Sequence[int]) -> int:
        """The fewest turns above 0 in which the projector gives so much light."""
        return next((n for n in counts if n and extent(light)[1] <= n * self.most * (1.0 + ROUNDING)), counts[-1])

    def _corrected(
        self, state: OptimizerState, light: DeviceArray, share: float, dose: DeviceArray, given: DeviceArray,
        wanted: DeviceArray,
    ) -> None:  # fmt: skip
        """Light, which gives ``share`` times a dose, times what is wanted over what it gives along each of its rays."""
        missing, there, here = state.volume(), state.sinogram(), state.sinogram()
        combine(1.0, wanted, -1.0, given, missing, floor=0.0)
        state.project(missing, there)
        state.project(dose, here)
        state.device.launch(
            correct_by_ratio, dose=here, scale=share, target=there, low=0.0, high=1.0, most=RATIO, model=light
        )

    def _lowered(self, state: OptimizerState, loss: Loss, given: DeviceArray, turns: int) -> DeviceArray:
        """Light of all the turns together, from the state's on, with what may be spent less one half."""
        gain = getattr(state.operator, "gain", None)
        gain = 1.0 if gain is None else dot(gain, gain) / prod(gain.shape)
        pace = Pace(1.0 / gain, soon=1.0, possible=True)
        channel = Channel(state, capped_ramp(state.operator, CAP, SPAN))
        steps = minimize(DoseObjective(state, loss, pace, rest=given), (channel,), pace)
        while state.affords(1.0 + 0.5) and next(steps, None) is not None:
            capped(channel.light, turns * self.most)
            capped(channel.ahead, turns * self.most)
        steps.close()
        return state.memory.get("best", state.memory["light"])

    def _loss(self, delivered: np.ndarray, part: np.ndarray, deviation: Any) -> Band:
        """The loss of what can still be mended."""

        def gone(dose: np.ndarray, part: np.ndarray, deviation: Any) -> np.ndarray:
            sure = dose - SURE * deviation
            return np.where(part, sure > self.greatest, sure >= self.inside)

        lost = by_planes(gone, delivered, part, np.asarray(deviation))
        band = Band.thresholds(self.outside, self.inside, self.greatest)
        if not lost.any() or lost.all():
            return band
        return Band(band.center, band.slack, band.gain, band.power, binary=True,
                    weight=(~lost).astype(np.float32))  # fmt: skip

    def _outlook(self, turns: int, dose: DeviceArray, target: DeviceArray, state: OptimizerState) -> Outlook:
        return Outlook(turns, state.window(dose)[0], float(score(dose, target, threshold=self.threshold).iou))

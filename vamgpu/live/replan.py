"""The light of the remaining turns, computed from the delivered dose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import hypot, inf, isfinite, prod
from typing import Any, Generic, TypeVar

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.geometry import positive
from vamgpu.kernels.update import correct_by_ratio
from vamgpu.kernels.watch import spare_voxels
from vamgpu.live.border import Border
from vamgpu.live.fields import scaled
from vamgpu.losses.band import Band
from vamgpu.losses.loss import Loss
from vamgpu.methods.exposure import DoseObjective
from vamgpu.methods.minimize import Channel, StepRule, minimize
from vamgpu.methods.part import fractions_of, one_limit
from vamgpu.methods.ramp import capped_ramp
from vamgpu.methods.state import OptimizerState
from vamgpu.metrics.histogram import above
from vamgpu.metrics.parts import Parts
from vamgpu.operators.compose import capped, combine
from vamgpu.operators.protocol import Operator
from vamgpu.operators.reductions import dot, extent, total
from vamgpu.operators.space import require

SURE = 2.0  # standard deviations by which a voxel must exceed its limit to be given up
LITTLE = 0.02  # dose of the first trial light if the part already has its dose, for voxels that do not
CAP, SPAN = 0.25, 0.25  # frequency [cycles per column] beyond which the preconditioner is level
ROUNDING = 1e-6  # share by which light may seem to exceed a bound
RATIO = 5.0  # greatest factor by which a pixel of the plan is brightened to reach the required dose
FORMED = 1.0  # distance of a print's surface from the part's [voxels] within which the print may stop
WORTH = 0.02  # distance by which further turns must bring the surface closer to the part's [voxels]


def finite(space: Any, values: Any, device: Device, name: str) -> DeviceArray:
    """Finite values on the device. Raises `BadInput`, `ShapeMismatch`."""
    require(space, values, name)
    known = isfinite(total(values)) if isinstance(values, DeviceArray) else np.isfinite(values).all()
    if not known:
        raise BadInput(f"{name} holds NaN or infinity; expected finite numbers: continue with the last plan")
    return device.field(values)


def allowed_turns(turns: Sequence[int], planned: int) -> list[int]:
    """Numbers of further turns, in order. Raises `BadInput`."""
    counts = sorted({int(count) for count in turns})
    if not counts or counts[0] < 0 or planned < 0:
        raise BadInput(f"got turns {list(turns)} and {planned} planned; expected whole numbers from 0 on")
    return counts


@dataclass(frozen=True)
class Forecast:
    """Forecast of a print."""

    turns: int  # number of remaining turns
    window: float  # strict process window, dimensionless
    iou: float  # overlap with the part at the threshold of the resin, dimensionless, 0..1
    least: float  # least overlap at the thresholds that the resin may have, dimensionless, 0..1


Light = TypeVar("Light")


@dataclass(frozen=True, eq=False)
class Replanned(Generic[Light]):
    """Light of each of the turns that remain."""

    light: Light  # of one turn, [angle, r, z] of each color on the device, at most the projector's; dark for a stop
    kept: Forecast  # forecast of the print with the running plan
    expected: Forecast  # forecast with this light; its ``turns`` is the moment to stop
    evaluations: float  # projector evaluations spent; a replay with the same number finds the same light


@dataclass(frozen=True, eq=False)
class _Task:
    """A task: delivered dose with further turns and without, light of a turn, allowed numbers of turns, errors."""

    state: OptimizerState
    target: DeviceArray
    border: Border
    given: DeviceArray
    now: DeviceArray
    light: DeviceArray
    counts: Sequence[int]
    error: float
    thresholds: Sequence[float]


@dataclass(frozen=True)
class _Printed:
    """A print, and the distance of its surface from the part's [voxels]."""

    forecast: Forecast
    off: float


@dataclass(frozen=True, eq=False)
class Replanner:
    """Optimizes the light of the turns that remain; all of these turns show the same light.

    The delivered dose enters the loss as an offset. Voxels that are certainly over their limit (void that is already
    printed, part above ``most``) cannot be corrected and have no weight. The expected surface of the print decides
    whether light is given, and how much.

    Args:
        target: A `Target`, or fractions [x, y, z].
        most: Greatest light of a pixel, in units of the plan's.
        outside: Greatest dose outside the part, in units of the part's dose.
        inside: Least dose in the part.
        greatest: Greatest dose in the part.
        threshold: Least dose that makes resin solid; the three doses above are scaled to put it midway between outside
            and inside. None does not scale them.

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
        self, operator: Operator, delivered: Any, plan: Any, planned: int, turns: Sequence[int], *,
        evaluations: float, deviation: Any = 0.0, expected_dose: Any = None, error: float = 0.0,
        thresholds: Sequence[float] = (), stopped: Any = None,
    ) -> Replanned[DeviceArray]:  # fmt: skip
        """The best light for the rest of a print with the given number of evaluations.

        Args:
            operator: The estimated operator, e.g. `Estimator.calibrated`.
            delivered: Dose so far, [x, y, z], NumPy or on the device, like ``plan``.
            plan: Planned light of each remaining turn, [angle, r, z].
            planned: Planned number of remaining turns.
            turns: Allowed numbers of further turns, 0 for a stop now.
            evaluations: Limit of projector evaluations: the available time times the machine's evaluations per second.
            deviation: Standard deviation of the delivered dose, [x, y, z], or one for all.
            expected_dose: Planned dose of the whole print, [x, y, z]; the plan's light is first corrected for what is
                missing of it. None starts with the plan's light unchanged.
            error: Relative error of the dose, which `Forecast.least` allows for.
            thresholds: Other least doses that may make resin solid, for it, in units of the part's dose; see
                `CuringResin.solid_doses`.
            stopped: Dose so far if no turn follows, [x, y, z]; None for that delivered.

        Returns:
            The light found, [angle, r, z], or the plan's own if its surface is no farther off.

        Raises:
            BadInput: A dose or light is not a number, or there are no turns.
            ShapeMismatch: An array has another geometry.
        """
        counts = allowed_turns(turns, planned)
        target, border = self._part(operator)
        state = OptimizerState(operator, target, {}, "loss")  # type: ignore[arg-type]
        state.most_evaluations = positive("evaluations", evaluations)
        given = finite(operator.domain, delivered, operator.device, "the delivered dose")
        light = finite(operator.range, plan, operator.device, "the plan's light")
        now = given if stopped is None else finite(operator.domain, stopped, operator.device, "the dose so far")
        task = _Task(state, target, border, given, now, light, counts, error, thresholds)
        dose = state.volume()
        state.expose(light, dose)
        kept = self._printed(task, planned, float(planned), dose)
        best, found = None, None
        if counts[-1]:
            fewest = self._begin(task, dose, expected_dose)
            loss = self._loss(given, target, deviation).on(state.field)
            best = self._lowered(state, loss, given, fewest)
            found = self._sized(task, best, dose)
        return self._chosen(task, planned, kept, best, found)

    def _begin(self, task: _Task, dose: DeviceArray, expected_dose: Any) -> int:
        """Make the total light of all turns the initial light; return the fewest turns that can give it."""
        state, light = task.state, task.light
        lacking = 0.5 * (self.inside + self.greatest) - state.part_mean(task.given)
        share = max(lacking, LITTLE) / state.part_mean(dose)
        begin = state.memory["light"] = state.sinogram()
        state.scale(share, light, begin)
        fewest = self._turns(begin, task.counts)
        if expected_dose is not None and state.affords(1.0 + 0.5):
            whole = finite(state.operator.domain, expected_dose, state.device, "the expected dose")
            self._corrected(state, begin, share, dose, task.given, whole)
        capped(begin, fewest * self.most)
        return fewest

    def _sized(self, task: _Task, light: DeviceArray, dose: DeviceArray) -> _Printed:
        """Scale light to bring the surface closest to the part's, as far as the projector can; return the print."""
        state, counts = task.state, task.counts
        state.expose(light, dose)
        possible = counts[-1] * self.most / max(extent(light)[1], 1e-30)
        share = min(task.border.share(task.given, dose), possible)
        state.scale(share, light, light)
        return self._printed(task, self._turns(light, counts), share, dose)

    def _chosen(
        self, task: _Task, planned: int, kept: _Printed, light: DeviceArray | None, found: _Printed | None
    ) -> Replanned[DeviceArray]:
        """Darkness, the plan's light or the light found, selected by the expected surface of the print."""
        counts, spent = task.counts, task.state.evaluations
        possible = planned in counts and extent(task.light)[1] <= self.most * (1.0 + ROUNDING)
        going_on = min(inf if found is None else found.off, kept.off if possible else inf)
        if counts[0] == 0 and task.border.off(task.now) <= min(FORMED, going_on + WORTH):
            return Replanned(scaled(task.light, 0.0), kept.forecast, self._forecast(task, 0, task.now), spent)
        if light is None or found is None or (possible and kept.off <= found.off):
            return Replanned(task.light, kept.forecast, kept.forecast, spent)
        task.state.scale(1.0 / found.forecast.turns, light, light)
        return Replanned(light, kept.forecast, found.forecast, spent)

    def _printed(self, task: _Task, turns: int, share: float, dose: DeviceArray) -> _Printed:
        """The print after a share of a dose."""
        whole = task.state.volume()
        combine(1.0, task.given, share, dose, whole)
        return _Printed(self._forecast(task, turns, whole), task.border.off(whole))

    def prepare(self, operator: Operator) -> None:
        """Find the part's border now instead of in the first plan.

        Args:
            operator: Operator as for `replan`, on the same device.
        """
        self._part(operator)

    def _part(self, operator: Operator) -> tuple[DeviceArray, Border]:
        """The part on an operator's device, and its border; found only once for all absorptions of the operator."""
        place = operator.device, operator.domain
        if place not in self._known:
            target = fractions_of(operator, one_limit(self.target))
            self._known[place] = target, Border(target.numpy(), self.threshold or 0.0)
        return self._known[place]

    def _turns(self, light: DeviceArray, counts: Sequence[int]) -> int:
        """The smallest number of turns above 0 in which the projector can give this light."""
        return next((n for n in counts if n and extent(light)[1] <= n * self.most * (1.0 + ROUNDING)), counts[-1])

    def _corrected(
        self, state: OptimizerState, light: DeviceArray, share: float, dose: DeviceArray, given: DeviceArray,
        expected_dose: DeviceArray,
    ) -> None:  # fmt: skip
        """Light that gives ``share`` times a dose, multiplied along each ray by the required over the given dose."""
        missing, there, here = state.volume(), state.sinogram(), state.sinogram()
        combine(1.0, expected_dose, -1.0, given, missing, floor=0.0)
        state.project(missing, there)
        state.project(dose, here)
        state.device.launch(
            correct_by_ratio, dose=here, scale=share, target=there, low=0.0, high=1.0, most=RATIO, model=light
        )

    def _lowered(self, state: OptimizerState, loss: Loss, given: DeviceArray, turns: int) -> DeviceArray:
        """Total light of all turns, starting from the state's, with half an evaluation less than the limit."""
        gain = getattr(state.operator, "gain", None)
        gain = 1.0 if gain is None else dot(gain, gain) / prod(gain.shape)
        pace = StepRule(1.0 / gain, soon=1.0, possible=True)
        channel = Channel(state, capped_ramp(state.operator, CAP, SPAN))
        steps = minimize(DoseObjective(state, loss, pace, rest=given, windows=False), (channel,), pace)
        while state.affords(1.0 + 0.5) and next(steps, None) is not None:
            for each in (channel.light, channel.ahead):
                if extent(each)[1] > turns * self.most:
                    capped(each, turns * self.most)
        steps.close()
        return state.memory.get("best", state.memory["light"])

    def _loss(self, delivered: DeviceArray, target: DeviceArray, deviation: Any) -> Band:
        """The loss of voxels that can still be corrected."""
        device, weight = delivered.device, delivered.device.empty(delivered.shape)
        even = not isinstance(deviation, DeviceArray) and np.ndim(deviation) == 0
        margin = 0.0 if isinstance(deviation, DeviceArray) or not even else SURE * float(deviation)
        device.launch(
            spare_voxels, dose=delivered, target=target, deviation=delivered if even else device.field(deviation),
            share=0.0 if even else SURE, margin=margin, inside=self.inside,
            greatest=self.greatest, weight=weight,
        )  # fmt: skip
        band = Band.thresholds(self.outside, self.inside, self.greatest)
        if not 0.0 < total(weight) < prod(weight.shape):
            return band
        return Band(band.center, band.slack, band.gain, band.power, binary=True, weight=weight)

    def _forecast(self, task: _Task, turns: int, dose: DeviceArray) -> Forecast:
        assert self.threshold is not None
        parts = Parts(dose, task.target, 0.5, None)
        overlaps, levels = [], np.array([self.threshold, *task.thresholds]) / self.threshold
        low, high = max(1.0 - hypot(1.0 - levels.min(), task.error), 0.0), 1.0 + hypot(levels.max() - 1.0, task.error)
        for level in self.threshold * np.array([1.0, low, high]):
            (_, excess), (missing, printed) = above(parts, float(np.float32(level)))[0].tolist()
            overlaps.append(printed / (missing + printed + excess))
        return Forecast(turns, task.state.window(dose)[0], overlaps[0], min(overlaps))

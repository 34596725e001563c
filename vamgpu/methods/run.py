"""`optimize`: one way to run every method."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from math import ceil, inf
from typing import Any

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.chemistry.oxygen import OxygenModel
from vamgpu.errors import (
    BadInput,
    Cancelled,
    Diverged,
    DivergenceWarning,
    OpticsWarning,
    OutOfMemory,
    SamplingWarning,
    ToleranceWarning,
)
from vamgpu.geometry import Grid, Turntable, counts, positive
from vamgpu.losses.loss import Loss
from vamgpu.methods.choice import check_bodies, chosen_for
from vamgpu.methods.lbfgs import LBFGS
from vamgpu.methods.limit import ExposureLimit
from vamgpu.methods.method import Method
from vamgpu.methods.part import fractions_of, limited, radius_of
from vamgpu.methods.plan import Plan, Step, copied
from vamgpu.methods.progress import Progress, reporting
from vamgpu.methods.resume import memory_of
from vamgpu.methods.start import begin
from vamgpu.methods.state import OptimizerState
from vamgpu.methods.surface import PIXEL_DEEP, SINOGRAMS, SurfaceRamp, across, as_fine_as_light, finer_voxels
from vamgpu.methods.tolerances import CornerDoses, Tolerances, check_lit, check_tolerances, doses_of
from vamgpu.methods.trajectory import LossTrajectory
from vamgpu.operators.compose import capped, combine
from vamgpu.operators.defocus import direct
from vamgpu.operators.protocol import Operator
from vamgpu.operators.reductions import extent
from vamgpu.operators.ring_projection import RingProjection, covers
from vamgpu.operators.scenarios import Scenarios
from vamgpu.operators.spectral import SpectralProjection
from vamgpu.optics.sampling import sampling_notes
from vamgpu.targets.limits import Limits
from vamgpu.targets.target import Target

DIMMED = 20
"""Greatest number of times that pixels are dimmed to keep an exposure limit; each slightly lowers the threshold."""
NOT_JUDGED = ("memory did not suffice to judge the light on the target's voxels: its window is that on the voxels of "
              "the optimization, a pixel from the surface")  # fmt: skip
"""Note of a plan."""
COARSE_CORNERS = ("memory did not suffice for all corners on voxels as fine as needed: the light was found on the "
                  "target's voxels; expected fewer tolerances, or a device with more memory")  # fmt: skip
"""Note of a plan."""


def optimize(
    operator: Operator,
    target: Any,
    method: str | Method | Loss = "default",
    iterations: int | None = None,
    *,
    tolerance: float = 0.0,
    progress: bool | Progress | None = None,
    cancel: Callable[[], bool] | None = None,
    resume: Plan | None = None,
    evaluations: float | None = None,
    start: Any = None,
    tolerances: Tolerances | None = None,
    exposure_limit: float | str | None = None,
    irradiance: float | str | None = None,
    critical_dose: float | str | None = None,
    absorption: float | str | None = None,
) -> Plan:
    """Find patterns [angle, r, z] ≥ 0 whose dose prints a target, on the operator's device.

    The plan holds the best patterns that the run evaluated, not its last; see `Plan`. For an operator on rings, rays
    through voxels judge the best and the last patterns at the end; `Plan.history` has the values on rings.

    Args:
        operator: The projector, or any object that is a `vamgpu.operators.protocol.Operator`. A `SpectralProjection`
            counts as a `RingProjection` on its rings: the dose is optimized and judged on the target's voxels.
        target: A `Target`, or fractions [x, y, z] (NumPy or on the device).
        method: A name from `METHODS` in any case, an instance, or a `vamgpu.losses.Loss` that `Descent` minimizes.
        iterations: Total number, including those of ``resume``; None for the method's own number, or for as many as
            ``evaluations`` allows. 0 returns the initial patterns: ``start``, otherwise filtered back projection.
        tolerance: Stop when the loss has fallen below this share of the first one (0: only when no gain is left).
        progress: A function that gets every `Step`; True shows a bar with the time left, False none. By default a bar
            is shown on a terminal and in a notebook.
        cancel: A function called before each iteration that returns whether to stop.
        resume: A plan of the same operator and method to continue; it does not change.
        evaluations: Limit of the total projector evaluations, including those of ``resume``: stop before the iteration
            that would exceed it. It is for comparing methods at equal cost. The first iteration is always made;
            evaluations that all methods spend before and after (see `Plan.evaluations`) do not count.
        start: Initial patterns, a plan or [angle, r, z] ≥ 0 of any library, in units of the dose the part should get;
            scaled if the part gets less than half or more than twice that. Not with ``resume``, and not for methods
            that start from the target.
        tolerances: Tolerances of machine and resin; the patterns then print at all corners with one threshold. Loss and
            window are then those of all corners together; see `Tolerances` and `Plan.corners`.
        exposure_limit: Longest exposure [s], until the dose midway between part and void is ``critical_dose``. Only for
            "default".
        irradiance: Irradiance of a full-on pixel in air [mW/mm²], for ``exposure_limit``. Like the others, also text
            with its unit.
        critical_dose: Least dose that makes resin solid [mJ/mm³], for ``exposure_limit``.
        absorption: Absorption of the resin [1/mm]; an ``exposure_limit`` needs it if the operator absorbs no light.

    Returns:
        The plan with the best patterns that the run evaluated.

    Raises:
        BadInput: A target, a method or a number cannot be used (also as `ShapeMismatch`, `EmptyMesh`,
            `TargetTooLarge`).
        BadInput: Full-on pixels everywhere would take longer than ``exposure_limit``.
        ToleranceError: A tolerance contradicts the print, or leaves a part of it without light.
        OutOfMemory: The device has too little memory.
        Cancelled: ``cancel`` returned true, or Ctrl-C; carries the plan so far.
        Diverged: The loss is no longer finite; carries the plan of the best patterns before.

    Warns:
        DivergenceWarning: The loss rose again by more than half of its decrease; names the iteration from which it
            rose. A loss of more than a thousand times its first value ends the run.
        SamplingWarning: Voxels or angles are too coarse for the pixels; also in the plan's notes.
        ToleranceWarning: The patterns do not print at every corner; names the limiting corners.
    """
    if resume is not None and not isinstance(resume, Plan):
        raise BadInput(f"got a {type(resume).__name__} as resume; expected a Plan: that of an earlier run, or "
                       "vam.load(path) of a saved one")  # fmt: skip
    check_tolerances(tolerances)
    if cancel is not None and not callable(cancel):
        raise BadInput(f"cancel is {cancel!r}; expected a function that returns whether to stop, or None")
    how = chosen_for(operator, resume.method if resume is not None and method == "default" else method)
    limit = _limit(how, iterations, evaluations)
    if isinstance(operator, OxygenModel):
        exposure_limit = _whole_exposure(operator, tolerances, exposure_limit, irradiance)
    brightest = ExposureLimit.of(exposure_limit, irradiance, critical_dose, absorption)
    _check_limit(how, operator, exposure_limit, limit)
    tolerance = positive("tolerance", tolerance, zero=True)
    posed: Any = _posed_on_voxels(operator, target)
    problem = _Problem.of(posed, target, how, tolerances)
    for note in problem.notes:
        warnings.warn(note, SamplingWarning, stacklevel=2)
    memory = memory_of(posed, target, how, resume, tolerances)
    state = problem.state(memory, how)
    _limit_light(state, operator, brightest, resume, problem.finer)
    if isinstance(operator, OxygenModel):
        operator.forget()
    state.most_evaluations = inf if evaluations is None else positive("evaluations", evaluations)
    if start is not None or (limit == 0 and resume is None):
        begin(state, how, start, resume, 1.0 / problem.finer)
    run = _Run(posed, how, state, target, resume, problem, tolerances=tolerances)
    with reporting(progress, limit) as report:
        run.go(limit, tolerance, report, cancel or (lambda: False))
    plan = run.plan()
    if brightest is not None and not (plan.window > 0.0 and run.within):
        _tell_limit(plan, brightest)
    return plan


@dataclass(frozen=True, eq=False)
class _Problem:
    """The optimization problem: operator, target and limits of its voxels, for all corners of tolerances."""

    operator: Any
    target: DeviceArray
    limits: Limits | None
    judge: OptimizerState | None  # on the caller's voxels, if the optimization uses different ones
    finer: float = 1.0  # ratio of the dose of the same light on these voxels to that on the caller's
    notes: tuple[str, ...] = ()

    @classmethod
    def of(cls, posed: Any, target: Any, method: Method, tolerances: Tolerances | None) -> _Problem:
        """The problem of a method: for `SurfaceRamp` on voxels finer than a pixel, if memory allows."""
        fractions, limits = fractions_of(posed, target), getattr(target, "limits", None)
        if limits is not None and (limits.weighted or limits.gray.any()):
            check_bodies(method, limits)
        fine = None if finer_voxels(method, posed, target) is None else as_fine_as_light(posed)
        notes = sampling_notes(posed if fine is None else fine, radius_of(posed, target, fractions))
        given = (posed, target, fractions, method, tolerances)
        if fine is None:
            return cls._on(*given, None, notes)
        try:
            return cls._on(*given, fine, notes)
        except OutOfMemory:
            if tolerances is None:
                raise
            return cls._on(*given, None, (*notes, COARSE_CORNERS))

    @classmethod
    def _on(
        cls, posed: Any, target: Any, fractions: DeviceArray, method: Method, tolerances: Tolerances | None,
        fine: Any, notes: tuple[str, ...],
    ) -> _Problem:  # fmt: skip
        limits = getattr(target, "limits", None)
        asked, sought, judge, finer = posed if limits is None else limited(posed, limits), fractions, None, 1.0
        if isinstance(method, SurfaceRamp):
            rays = direct(posed)
            judge = _at_corners(rays if limits is None else limited(rays, limits), fractions, tolerances)
            if fine is not None:
                asked, finer = fine, fine.grid.voxel_volume / posed.grid.voxel_volume
            sought = across(target, posed.grid, asked, method.width)
        if tolerances is None:
            return cls(asked, sought, limits, judge and OptimizerState(*judge, {}), finer, notes)
        asked, stacked = _at_corners(asked, sought, tolerances)
        check_lit(asked, tolerances, sought)
        limits = None if limits is None else limits.stacked(len(asked))
        if fine is not None and not OptimizerState(asked, stacked, {}).has_room(1, SINOGRAMS):
            raise OutOfMemory(COARSE_CORNERS)
        return cls(asked, stacked, limits, judge and OptimizerState(*judge, {}), finer, notes)

    def state(self, memory: dict[str, Any], method: Method) -> OptimizerState:
        """The state of a run of this problem."""
        limits, criterion = self.limits, method.criterion
        if limits is not None and (limits.weighted or limits.gray.any()):
            criterion = "loss"  # a window ignores weights and the upper limit of a gray dose
        state = OptimizerState(self.operator, self.target, memory, criterion, limits)
        if isinstance(method, SurfaceRamp) and extent(self.target)[1] > 0.5 + PIXEL_DEEP:  # some voxels are that deep
            state.margin = PIXEL_DEEP
        return state


def _at_corners(operator: Any, target: DeviceArray, tolerances: Tolerances | None) -> tuple[Any, DeviceArray]:
    """Operator and target of all corners, or of the nominal print without tolerances."""
    if tolerances is None:
        return operator, target
    scenarios = tolerances.scenarios(operator)
    return scenarios, scenarios.stacked([target] * len(scenarios))


def _check_limit(method: Method, operator: Any, exposure_limit: Any, limit: int) -> None:
    """Reject an exposure limit for a method that does not support it, and for a run without iterations."""
    if exposure_limit is None:
        return
    if limit == 0:
        raise BadInput(f"got exposure_limit={exposure_limit!r} with iterations=0, which cannot dim light; expected "
                       "iterations ≥ 1, or no limit")  # fmt: skip
    if not isinstance(method, LBFGS if isinstance(operator, OxygenModel) else SurfaceRamp):
        raise BadInput(f'got exposure_limit with {method!r}; expected "default", which limits the brightness')


def _whole_exposure(model: OxygenModel, tolerances: Any, exposure_limit: Any, irradiance: Any) -> float | None:
    """Exposure limit of a model of oxygen with a known lamp: all of its turns."""
    if tolerances is not None:
        raise BadInput("got tolerances with an OxygenModel; expected one of them: leave out the tolerances")
    if exposure_limit not in (None, model.oxygen.seconds):
        raise BadInput(f"got exposure_limit={exposure_limit!r} with an OxygenModel, whose exposure is {model.turns:,} "
                       f"turns of {model.period:g} s; expected irradiance and critical_dose alone")  # fmt: skip
    return exposure_limit if irradiance is None else model.oxygen.seconds


def _limit_light(
    state: OptimizerState, operator: Operator, limit: ExposureLimit | None, resume: Plan | None, finer: float
) -> None:
    """Limit the brightness of a run's light to the exposure. Raises `BadInput`."""
    if limit is None:
        if "brightness" in state.memory:
            raise BadInput("the plan to resume has an exposure limit; resume it with that, or start with its light")
        return
    brightness = limit.brightness(operator)
    if resume is not None and state.memory.get("brightness") != brightness:
        raise BadInput(
            "the plan to resume has another exposure limit; resume it with its own, or give its light as start"
        )
    state.memory["brightness"], state.brightness = brightness, brightness / finer
    if isinstance(operator, OxygenModel):
        state.memory["most"] = state.most = state.brightness  # the effective dose at the threshold is 1
    light = state.brightness if isinstance(operator, OxygenModel) else 1.0  # doses with oxygen are not linear in it
    even, dose = state.device.upload(np.full(state.operator.range.shape, light, np.float32)), state.volume()
    state.operator.T(even, out=dose)
    least = extent(dose, state.target, 0.5, inf, state.reach)[0]
    if isinstance(operator, OxygenModel):
        limit.check_turns(operator.turns, least)
    else:
        limit.check(operator, least / finer)


def _tell_limit(plan: Plan, limit: ExposureLimit) -> None:
    """Warn of a limit that leaves no window."""
    warnings.warn(
        f"no patterns with a strict window were found within the exposure limit, {limit.seconds:.4g} s: the widest is "
        f"{max(plan.window, -1.0):+.3f}; use more time, a brighter lamp or more iterations; a run without the limit "
        "shows what the part allows",
        OpticsWarning,
        stacklevel=3,
    )


@dataclass
class _Run:
    operator: Operator
    method: Method
    state: OptimizerState
    target: Any
    resumed: Plan | None
    problem: _Problem
    history: list[Step] = field(default_factory=list)
    started: float = field(default_factory=time.perf_counter)
    tolerances: Tolerances | None = None
    within: bool = True  # whether the exposure of a plan's light is within the limit
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.resumed is not None:
            self.history = list(self.resumed.history)
        self.notes = self.problem.notes

    def go(self, limit: int, tolerance: float, report: Progress, cancel: Callable[[], bool]) -> None:
        steps, state = self.method.steps(self.state), self.state
        try:
            while len(self.history) < limit and (not self.history or state.affords(self.method.cost)):
                if cancel():
                    raise self._cancelled("cancelled by the caller")
                state.iteration = len(self.history)
                record = next(steps, None)
                if record is None:
                    break
                self.history.append(Step(len(self.history) + 1, state.evaluations, *record))
                state.iteration = len(self.history)
                report(self.history[-1])
                if (look := getattr(report, "look", None)) is not None:
                    look(self._slice)
                ends = LossTrajectory([self.history[0].loss, self.history[-1].loss])
                if ends.lost:
                    trajectory, state.best.unseen = self._trajectory(), None  # the last light is invalid
                    best = self.plan() if "best" in state.memory else None
                    raise Diverged(trajectory.message(), best, trajectory.began)
                if ends.blown or record[0] <= tolerance * ends.losses[0]:
                    break
        except KeyboardInterrupt:
            raise self._cancelled("interrupted") from None
        finally:
            steps.close()
        if self.history and self._trajectory().risen:
            warnings.warn(self._trajectory().message(), DivergenceWarning, stacklevel=3)

    def _slice(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Dose and target [y, z] at the middle x, of the nominal print; None if memory does not suffice."""
        state, A, target = self.state, self.state.operator, self.state.target
        if isinstance(A, Scenarios):
            A, target = A.operators[0], A.taken(target, 0)
        try:
            dose = None if "light" not in state.memory else A.T(state.buffer("light"))
        except OutOfMemory:
            dose = None
        if dose is None:
            return None
        middle = dose.shape[0] // 2
        return dose.part(middle, middle + 1)[0], target.part(middle, middle + 1)[0]

    def _trajectory(self) -> LossTrajectory:
        return LossTrajectory([step.loss for step in self.history])

    def _cancelled(self, why: str) -> Cancelled:
        plan = self.plan() if self.history else None
        return Cancelled(
            f"{why} after {len(self.history)} iterations; pass the error's plan as resume= to continue from there", plan
        )

    def plan(self) -> Plan:
        """The best light so far, judged by its operator."""
        state, before = self.state, self.resumed
        if before is not None and len(self.history) == len(before.history):
            return before
        light, window, iteration = state.best.choose(state)
        rays, field_ = by_rays(state.operator), state.target
        if (judge := self.problem.judge) is not None:
            light, window = self._by_voxels(judge, light, window)
            rays, field_ = judge.operator, judge.target
        elif rays is not state.operator and state.limits is None and (judged := self._judged(rays, light, iteration)):
            light, window, iteration = judged
        certify = getattr(self.method, "certify", None)
        bound = None if certify is None else certify(state)
        grid, motion = (getattr(self.operator, name, None) for name in ("grid", "motion"))
        on = f"{grid}, {motion.moves}" if isinstance(grid, Grid) and isinstance(motion, Turntable) else ""
        bound = bound and replace(bound, on=on)
        seconds = (before.seconds if before else 0.0) + time.perf_counter() - self.started
        return Plan(
            light,
            self.operator,
            self.method,
            tuple(self.history),
            window,
            state.evaluations,
            self.method.papers,
            seconds,
            str(getattr(self.target, "name", "target")),
            dict(state.memory),
            iteration,
            bound,
            self.target,
            self.tolerances,
            self._corners(light, rays, field_),
            self.notes,
        )

    def _by_voxels(self, judge: OptimizerState, light: DeviceArray, window: float) -> tuple[DeviceArray, float]:
        """Light in units of the dose on the target's voxels, within its exposure limit, and its window by rays."""
        finer = self.problem.finer
        most = self.state.brightness * finer
        if finer != 1.0:
            light = combine(finer, light, 0.0, light, self.state.sinogram())
        try:
            for _ in range(DIMMED):  # the threshold is known now, and may be lower than assumed
                dose = judge.operator.T(light)
                window = judge.window(dose)[0]
                least, leak, _ = judge.extremes(dose)
                limit = 0.5 * most * (least + max(leak, 0.0)) if most < inf else inf
                self.within = extent(light)[1] <= limit
                if self.within or not 0.0 < limit < inf:
                    break
                light = capped(copied(light), (1.0 - 1e-4) * limit)
        except OutOfMemory:
            self.within = most == inf  # the window remains that of the run
            self.notes += (NOT_JUDGED,)
        return light, window

    def _judged(self, rays: Any, light: DeviceArray, iteration: int) -> tuple[DeviceArray, float, int] | None:
        """Light, window and iteration by rays, from the better of the best and the last light; None without memory."""
        state = self.state
        try:
            found = [(light, state.window(rays.T(light))[0], iteration)]
            last = state.memory.get("light")
            if state.best.criterion == "window" and last is not None:
                found.append((last, state.window(rays.T(last))[0], state.iteration))
        except OutOfMemory:
            return None
        return max(found, key=lambda each: each[1])

    def _corners(self, light: DeviceArray, scenarios: Any, target: DeviceArray) -> CornerDoses | None:
        """The doses of the light at every corner; warns if it does not print at all of them."""
        if self.tolerances is None or not isinstance(scenarios, Scenarios):
            return None
        doses = doses_of(scenarios, self.tolerances, light, scenarios.taken(target, 0))
        if doses.window <= 0.0:
            warnings.warn(
                f"the light does not print at every corner of its tolerances: {doses.statement()}; use smaller ones, "
                "or more iterations",
                ToleranceWarning,
                stacklevel=4,
            )
        return doses


def _posed_on_voxels(operator: Any, target: Any) -> Any:
    """A projection on rings as one on the target's voxels, because light cannot distinguish cells near the axis."""
    if not isinstance(operator, SpectralProjection):
        return operator
    grid = target.grid if isinstance(target, Target) else operator.grid.box
    rings = operator.grid if covers(operator.grid, grid) else None
    scene = (operator.beam, operator.motion, operator.vessel, operator.device)
    return RingProjection(grid, *scene, rings=rings, tf32=operator.tf32)


def by_rays(operator: Any) -> Any:
    """The same operator by rays through voxels if one computes on rings; otherwise the operator itself."""
    if isinstance(operator, Scenarios):
        rays = [by_rays(each) for each in operator.operators]
        alike = all(one is each for one, each in zip(rays, operator.operators, strict=True))
        return operator if alike else Scenarios(rays, operator.mix)
    return operator.direct if isinstance(operator, RingProjection) else operator


def _limit(method: Method, iterations: int | None, evaluations: float | None) -> int:
    if isinstance(iterations, bool):
        raise BadInput(f"iterations is {iterations!r}; expected a whole number ≥ 0")
    if iterations is not None:
        return 0 if iterations == 0 else counts("iterations", (iterations,), 1)[0]
    if evaluations is None:
        return method.iterations
    return ceil(positive("evaluations", evaluations))  # an iteration takes at least one

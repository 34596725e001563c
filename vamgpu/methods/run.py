"""`optimize`: one way to run every method."""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib.util import find_spec
from math import ceil, inf
from typing import Any

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.deprecated import renamed_arguments
from vamgpu.errors import BadInput, Cancelled, Diverged, DivergenceWarning, OpticsWarning, ToleranceWarning
from vamgpu.geometry import counts, positive
from vamgpu.losses.loss import Loss
from vamgpu.methods.bclp import BCLP
from vamgpu.methods.calgd import GradientDescent
from vamgpu.methods.default import BestWindow
from vamgpu.methods.descent import Descent
from vamgpu.methods.fbp import FilteredBackProjection
from vamgpu.methods.lbfgs import LBFGS
from vamgpu.methods.limit import ExposureLimit
from vamgpu.methods.method import Method
from vamgpu.methods.osmo import OSMO
from vamgpu.methods.part import fractions_of, limited
from vamgpu.methods.penalty import PenaltyMinimization
from vamgpu.methods.plan import Plan, Step, copied
from vamgpu.methods.projector import Projector
from vamgpu.methods.recipe import Recipe
from vamgpu.methods.start import begin
from vamgpu.methods.state import OptimizerState
from vamgpu.methods.tolerances import CornerDoses, Tolerances, check_lit, check_tolerances, doses_of
from vamgpu.methods.trajectory import LossTrajectory
from vamgpu.methods.widest import WidestWindow
from vamgpu.methods.window import ProcessWindow
from vamgpu.operators.reductions import extent
from vamgpu.operators.ring_projection import RingProjection, are_enough
from vamgpu.operators.scenarios import Scenarios
from vamgpu.operators.spectral import SpectralProjection
from vamgpu.targets.limits import Limits
from vamgpu.targets.target import Target

METHODS: dict[str, type[Any]] = {
    "default": BestWindow,
    "best": BestWindow,
    "window": ProcessWindow,
    "widest": WidestWindow,
    "recipe": Recipe,
    "fbp": FilteredBackProjection,
    "cal": GradientDescent,
    "osmo": OSMO,
    "penalty": PenaltyMinimization,
    "bclp": BCLP,
    "lbfgs": LBFGS,
}
"""Names a method can be chosen by, with default parameters."""

Progress = Callable[[Step], None]


@renamed_arguments(pairs="evaluations")
def optimize(
    operator: Projector,
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
    """Find light [angle, r, z] ≥ 0 whose dose prints a target, on the operator's device.

    The plan holds the best light that the run evaluated, not its last; see `Plan`.

    Args:
        operator: The projector, or any object that is a `vamgpu.operators.protocol.Operator`. A `SpectralProjection`
            stands for a `RingProjection` on its rings: the dose is asked for, and judged, on the target's voxels.
        target: A `Target`, or fractions [x, y, z] (NumPy or on the device).
        method: A name of `METHODS`, an instance, or a `vamgpu.losses.Loss` that `Descent` lowers.
        iterations: In all, those of ``resume`` included; None takes the method's own, or what ``evaluations`` allows.
        tolerance: Stop once the loss has fallen below this share of the first one (0: only when nothing is left to
            gain).
        progress: A function gets every `Step`; True shows a bar with the time left, False none. By default a bar is
            shown where somebody looks: on a terminal and in a notebook.
        cancel: Asked before each iteration.
        resume: A plan of the same operator and method to go on from; it stays as it is.
        evaluations: Projector evaluations that may be spent in all, those of ``resume`` included: stop before the
            iteration that would exceed them. Compares methods at equal cost. The first iteration is always made; what
            every method spends alike before and after (see `Plan.evaluations`) is not counted.
        start: Light to begin with, a plan or [angle, r, z] ≥ 0 of any library, in units of the dose the part should
            get; scaled where the part gets less than half or more than twice that. Not with ``resume``, and not for
            methods that begin with the target.
        tolerances: How far machine and resin may be off: one light for all corners, with one threshold. Loss, window
            and bound are then those of all corners together; see `Tolerances` and `Plan.corners`.
        exposure_limit: Time [s] that the light may last at most, until the dose midway between part and void is
            ``critical_dose``: the widest window of such light. For "default" and "widest" alone.
        irradiance: Of a full-on pixel in air [mW/mm²], where there is a limit. Like the others also text with its unit.
        critical_dose: From which resin is solid [mJ/mm³], where there is a limit.
        absorption: Of the resin [1/mm], where there is a limit and the operator absorbs no light.

    Returns:
        The plan with the best light that the run evaluated.

    Raises:
        BadInput: For a target, a method or a number that cannot be used (also as `ShapeMismatch`, `EmptyMesh`,
            `TargetTooLarge`).
        BadInput: Full-on pixels everywhere would take longer than ``exposure_limit``; says what binds.
        ToleranceError: A tolerance contradicts the print, or leaves a part of it without light; says which.
        OutOfMemory: Where the device is too small.
        Cancelled: When ``cancel`` says so or on Ctrl-C; carries the plan reached so far.
        Diverged: When the loss is no finite number any more; carries the plan of the best light before.

    Warns:
        DivergenceWarning: When more than half of what the loss had fallen is lost again, with the iteration from which
            it rose. A loss that exceeds a thousand times its first value ends the run.
        ToleranceWarning: When the light found does not print at every corner, with the corners that hold it.
    """
    if resume is not None and not isinstance(resume, Plan):
        raise BadInput(f"got a {type(resume).__name__} as resume; expected a Plan: that of an earlier run, or "
                       "vam.load(path) of one that was saved")  # fmt: skip
    check_tolerances(tolerances)
    if cancel is not None and not callable(cancel):
        raise BadInput(f"cancel is {cancel!r}; expected a function that says whether to stop, or None")
    how = chosen(resume.method if resume is not None and method == "default" else method)
    limit = _limit(how, iterations, evaluations)
    tolerance = positive("tolerance", tolerance, zero=True)
    posed: Any = _posed_on_voxels(operator, target)
    field_ = fractions_of(posed, target)
    limits = getattr(target, "limits", None)
    criterion = how.criterion
    if limits is not None and (limits.weighted or limits.gray.any()):
        _check_bodies(how, limits)
        criterion = "loss"  # a window knows neither weights nor the upper end of a gray dose
    asked = posed if limits is None else limited(posed, limits)
    memory = _memory(posed, target, how, resume, tolerances)
    scenarios = None
    if tolerances is not None:
        scenarios = asked = tolerances.scenarios(asked)
        check_lit(scenarios, tolerances, field_)
        field_ = scenarios.stacked([field_] * len(scenarios))
        limits = None if limits is None else limits.stacked(len(scenarios))
    state = OptimizerState(asked, field_, memory, criterion, limits)
    brightest = ExposureLimit.of(exposure_limit, irradiance, critical_dose, absorption)
    if brightest is not None:
        _limit_light(state, how, operator, brightest, resume)
    elif "brightness" in memory:
        raise BadInput("the plan to resume has an exposure limit; resume it with that, or start with its light")
    state.most_evaluations = inf if evaluations is None else positive("evaluations", evaluations)
    state.budget = min(limit * how.cost * getattr(asked, "cost", 1.0), state.most_evaluations)
    if start is not None:
        begin(state, how, start, resume)
    run = _Run(posed, how, state, target, resume, tolerances=tolerances)
    with _reporting(progress, limit) as report:
        run.go(limit, tolerance, report, cancel or (lambda: False))
    plan = run.plan()
    kept = state.best.window >= -1.0 and ("rows" in plan.state or "free" in plan.state)
    if brightest is not None and not (plan.window > 0.0 and kept):
        _tell_limit(plan, brightest)
    return plan


def _limit_light(
    state: OptimizerState, method: Method, operator: Projector, limit: ExposureLimit, resume: Plan | None
) -> None:  # fmt: skip
    """Let a run find no light that lasts longer than it may. Raises `BadInput`."""
    if not isinstance(method, (BestWindow, WidestWindow)):
        raise BadInput(f"got exposure_limit with {method!r}; expected \"default\" or \"widest\", which seek the widest "
                       "window of light that is no brighter")  # fmt: skip
    brightness = limit.brightness(operator)
    if resume is not None and state.memory.get("brightness") != brightness:
        raise BadInput(
            "the plan to resume has another exposure limit; resume it with its own, or give its light as start"
        )
    state.memory["brightness"] = state.brightness = brightness
    even, dose = state.device.upload(np.ones(state.operator.range.shape, np.float32)), state.volume()
    state.operator.T(even, out=dose)
    limit.check(operator, extent(dose, state.target, 0.5, inf, state.reach)[0])


def _tell_limit(plan: Plan, limit: ExposureLimit) -> None:
    """Warn of a limit that leaves no window."""
    warnings.warn(
        f"no light that prints was found within the exposure limit of {limit.seconds:.4g} s: the widest window is "
        f"{max(plan.window, -1.0):+.3f}; take more time, a brighter lamp or more iterations; without the limit the run "
        "tells what the part itself allows",
        OpticsWarning,
        stacklevel=3,
    )


@dataclass
class _Run:
    """One run in progress."""

    operator: Projector
    method: Method
    state: OptimizerState
    target: Any
    resumed: Plan | None
    history: list[Step] = field(default_factory=list)
    started: float = field(default_factory=time.perf_counter)
    tolerances: Tolerances | None = None

    def __post_init__(self) -> None:
        if self.resumed is not None:
            self.history = list(self.resumed.history)

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
                ends = LossTrajectory([self.history[self._start()].loss, self.history[-1].loss])
                if ends.lost:
                    trajectory = self._trajectory()
                    raise Diverged(trajectory.message(), self._plan_of_best(), trajectory.began)
                if ends.blown or record[0] <= tolerance * ends.losses[0]:
                    break
        except KeyboardInterrupt:
            raise self._cancelled("interrupted") from None
        finally:
            steps.close()
        if self.history and self._trajectory().risen:
            warnings.warn(self._trajectory().message(), DivergenceWarning, stacklevel=4)

    def _start(self) -> int:
        """Iterations before losses meant the same as now."""
        return min(int(self.state.number("stage")), len(self.history) - 1)

    def _trajectory(self) -> LossTrajectory:
        """Losses since they mean the same."""
        start = self._start()
        return LossTrajectory([step.loss for step in self.history[start:]], start)

    def _plan_of_best(self) -> Plan | None:
        """The plan of a run whose last light is of no use; None without any other."""
        self.state.best.unseen = None
        return self.plan() if "best" in self.state.memory else None

    def _cancelled(self, why: str) -> Cancelled:
        plan = self.plan() if self.history else None
        return Cancelled(
            f"{why} after {len(self.history)} iterations; pass the error's plan as resume= to go on from there", plan
        )

    def plan(self) -> Plan:
        state, before = self.state, self.resumed
        if before is not None and len(self.history) == len(before.history):
            return before
        if isinstance(state.operator, Scenarios):
            state.operator.rest((False,) * len(state.operator), None)
        light, window, iteration = state.best.choose(state)
        if window < -1.0:  # of light that is brighter than it may be, which all other went before
            window = state.window(state.operator.T(light))[0]
        certify = getattr(self.method, "certify", None)
        bound = None if certify is None else certify(state)
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
            _name(self.target),
            dict(state.memory),
            iteration,
            bound,
            self.target,
            self.tolerances,
            self._corners(light),
        )

    def _corners(self, light: DeviceArray) -> CornerDoses | None:
        """What the light gives at every corner; warns where it does not print at all of them."""
        scenarios = self.state.operator
        if self.tolerances is None or not isinstance(scenarios, Scenarios):
            return None
        told = doses_of(scenarios, self.tolerances, light, scenarios.taken(self.state.target, 0))
        if told.window <= 0.0:
            warnings.warn(
                f"the light does not print at every corner of its tolerances: {told.statement()}; take smaller ones, "
                "or more iterations where the bound leaves room",
                ToleranceWarning,
                stacklevel=5,
            )
        return told


def _posed_on_voxels(operator: Any, target: Any) -> Any:
    """A projection on rings as one of the target's voxels: cells have unlike volumes, and no light tells apart those
    near the axis, which are narrower than a pixel. Any other operator itself."""
    if not isinstance(operator, SpectralProjection):
        return operator
    grid = target.grid if isinstance(target, Target) else operator.grid.box
    rings = operator.grid if are_enough(operator.grid, grid) else None
    scene = (operator.beam, operator.motion, operator.vessel, operator.device)
    return RingProjection(grid, *scene, rings=rings, tf32=operator.tf32)


def chosen(method: str | Method | Loss) -> Method:
    """The method meant by a name, an instance, or a loss to lower. Raises `BadInput`."""
    if isinstance(method, Loss):
        return Descent(method)
    if isinstance(method, str):
        if method not in METHODS:
            raise BadInput(f"no method {method!r}; there are {', '.join(METHODS)}, or give an instance")
        return METHODS[method]()
    if isinstance(method, type) or not hasattr(method, "steps"):
        raise BadInput(
            f"got {method!r} as method; expected a name ({', '.join(METHODS)}), a loss, or an instance such as OSMO()"
        )
    return method


def _check_bodies(method: Method, limits: Limits) -> None:
    """Refuse weights of bodies, and gray ones, for a method whose light does not depend on them."""
    for trait, given, what in (
        ("takes_weights", limits.weighted, "bodies of the target have weights, at which {} does not look; expected 1"),
        (
            "takes_gray",
            limits.gray.any(),
            "bodies of the target are gray, which {} holds from below alone; expected none",
        ),
    ):
        if given and not getattr(method, trait, True):
            able = ", ".join(name for name, kind in METHODS.items() if getattr(kind, trait, True))
            raise BadInput(
                f"{what.format(type(method).__name__)}, or one of these methods: {able}, or a loss of your own"
            )


def _limit(method: Method, iterations: int | None, evaluations: float | None) -> int:
    """Iterations at most."""
    if iterations is not None:
        return _count(iterations)
    if evaluations is None:
        return method.iterations
    return ceil(positive("evaluations", evaluations))  # an iteration takes at least one


def _count(iterations: int) -> int:
    if isinstance(iterations, bool):
        raise BadInput(f"iterations is {iterations!r}; expected a whole number ≥ 1")
    return counts("iterations", (iterations,), 1)[0]


def _name(target: Any) -> str:
    return str(getattr(target, "name", "target"))


def of_another(plan: Plan, operator: Projector, target: Any, tolerances: Tolerances | None) -> str:
    """What of a task a plan was made for is not that of another; empty where all is.

    Args:
        plan: Of the one task.
        operator, target, tolerances: Of the other.

    Returns:
        Both, in words.
    """
    operator = _posed_on_voxels(operator, target)  # as the plan's was
    for name in ("grid", "beam", "motion", "vessel"):
        before, now = (getattr(each, name, None) for each in (plan.operator, operator))
        alike = repr(before) == repr(now) if name == "vessel" else before == now  # fields of a medium know no ==
        if not alike:
            return f"{before!r}, not of {now!r}"
    if plan.tolerances != tolerances:
        return f"{plan.tolerances!r}, not of {tolerances!r}"
    if plan.target is not None and plan.target is not target:
        before, now = (np.asarray(getattr(each, "numpy", lambda each=each: each)()) for each in (plan.target, target))
        if before.shape != now.shape or not np.array_equal(before, now):
            return "another target"
    return ""


def _memory(
    operator: Projector, target: Any, method: Method, resume: Plan | None, tolerances: Tolerances | None
) -> dict[str, Any]:  # fmt: skip
    """A copy of what a plan remembers, so that the plan stays what it is."""
    if resume is None:
        return {}
    if resume.operator.device is not operator.device or resume.sinogram.shape != operator.range.shape:
        raise BadInput(
            f"the plan to resume has light {resume.sinogram.shape} on {resume.operator.device}; expected "
            f"{operator.range.shape} on {operator.device}: resume with the operator that made it"
        )
    if resume.operator.domain.shape != operator.domain.shape:
        raise BadInput(f"the plan to resume has a dose of {resume.operator.domain.shape}, the operator one of "
                       f"{operator.domain.shape}; resume with the operator that made it")  # fmt: skip
    if resume.method != method:
        raise BadInput(f"the plan to resume is by {resume.method!r}, not by {method!r}; resume with the same method")
    if other := of_another(resume, operator, target, tolerances):
        raise BadInput(f"the plan to resume is of {other}; resume what it was made for, or give its light as start")
    return copied(resume.state)


def watched() -> bool:
    """Whether somebody looks: a person at a terminal, or at a notebook.

    Returns:
        False where output goes to a file or a pipe.
    """
    shell = sys.modules.get("IPython")
    if shell is not None and type(shell.get_ipython()).__name__ == "ZMQInteractiveShell":
        return find_spec("ipywidgets") is not None  # what draws bars there
    return bool(getattr(sys.stdout, "isatty", bool)())


@contextmanager
def _reporting(progress: bool | Progress | None, limit: int) -> Iterator[Progress]:
    """Where steps are reported: nowhere, to a function, or to a bar on the terminal or in a notebook."""
    if callable(progress):
        yield progress
    elif progress or (progress is None and watched()):
        from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
        from rich.progress import Progress as Bars

        left = (BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(), TextColumn("left"))
        with Bars(TextColumn("{task.description}"), *left, transient=progress is None) as bars:
            task = bars.add_task("optimizing", total=limit)
            bars.refresh()  # a run may end before the bar's own clock ticks
            yield lambda step: bars.update(
                task, completed=step.iteration, description=f"loss {step.loss:.3g}, window {step.window:+.3f}"
            )
    else:
        yield lambda step: None

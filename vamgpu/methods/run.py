"""`optimize`: one way to run every method."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from math import ceil, inf
from typing import Any

from vamgpu.backend.array import DeviceArray
from vamgpu.errors import BadInput, Cancelled, Diverged, DivergenceWarning
from vamgpu.geometry import counts, positive
from vamgpu.losses.loss import Loss
from vamgpu.methods.bclp import BCLP
from vamgpu.methods.calgd import GradientDescent
from vamgpu.methods.course import Course
from vamgpu.methods.descent import Descent
from vamgpu.methods.fbp import FilteredBackProjection
from vamgpu.methods.lbfgs import LBFGS
from vamgpu.methods.method import Method
from vamgpu.methods.osmo import OSMO
from vamgpu.methods.part import fractions_of
from vamgpu.methods.penalty import PenaltyMinimization
from vamgpu.methods.plan import Plan, Step
from vamgpu.methods.projector import Projector
from vamgpu.methods.recipe import Recipe
from vamgpu.methods.window import ProcessWindow
from vamgpu.methods.work import Work
from vamgpu.operators.compose import combine

METHODS: dict[str, type[Any]] = {
    "default": ProcessWindow,
    "window": ProcessWindow,
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
    pairs: float | None = None,
) -> Plan:
    """Find light [angle, r, z] ≥ 0 whose dose prints a target, on the operator's device.

    The plan holds the best light that the run evaluated, not its last; see `Plan`.

    Args:
        operator: The projector.
        target: A `Target`, or fractions [x, y, z] (NumPy or on the device).
        method: A name of `METHODS`, an instance, or a `vamgpu.losses.Loss` that `Descent` lowers.
        iterations: In all, those of ``resume`` included; None takes the method's own, or what ``pairs`` allows.
        tolerance: Stop once the loss has fallen below this share of the first one (0: only when nothing is left to
            gain).
        progress: True shows a bar, a function gets every `Step`.
        cancel: Asked before each iteration.
        resume: A plan of the same operator and method to go on from; it stays as it is.
        pairs: Projector pairs that may be spent in all, those of ``resume`` included: stop before the iteration that
            would exceed them. Compares methods at equal cost. The first iteration is always made; what every method
            spends alike before and after (see `Plan.pairs`) is not counted.

    Raises:
        BadInput: For a target, a method or a number that cannot be used (also as `ShapeMismatch`, `EmptyMesh`,
            `TargetTooLarge`).
        OutOfMemory: Where the device is too small.
        Cancelled: When ``cancel`` says so or on Ctrl-C; carries the plan reached so far.
        Diverged: When the loss is no finite number any more; carries the plan of the best light before.

    Warns:
        DivergenceWarning: When more than half of what the loss had fallen is lost again, with the iteration from which
            it rose. A loss that exceeds a thousand times its first value ends the run.
    """
    how = chosen(resume.method if resume is not None and method == "default" else method)
    limit = _limit(how, iterations, pairs)
    tolerance = positive("tolerance", tolerance, zero=True)
    field_ = fractions_of(operator, target)
    work = Work(operator, field_, _memory(operator, how, resume), how.criterion)
    work.most_pairs = inf if pairs is None else positive("pairs", pairs)
    run = _Run(operator, how, work, _name(target), resume)
    with _reporting(progress, limit) as report:
        run.go(limit, tolerance, report, cancel or (lambda: False))
    return run.plan()


@dataclass
class _Run:
    """One run in progress."""

    operator: Projector
    method: Method
    work: Work
    name: str
    resumed: Plan | None
    history: list[Step] = field(default_factory=list)
    started: float = field(default_factory=time.perf_counter)

    def __post_init__(self) -> None:
        if self.resumed is not None:
            self.history = list(self.resumed.history)

    def go(self, limit: int, tolerance: float, report: Progress, cancel: Callable[[], bool]) -> None:
        steps, work = self.method.steps(self.work), self.work
        try:
            while len(self.history) < limit and (not self.history or work.affords(self.method.cost)):
                if cancel():
                    raise self._cancelled("cancelled by the caller")
                work.iteration = len(self.history)
                record = next(steps, None)
                if record is None:
                    break
                self.history.append(Step(len(self.history) + 1, work.pairs, *record))
                work.iteration = len(self.history)
                report(self.history[-1])
                course = self._course()
                if course.lost:
                    raise Diverged(course.message(), self._plan_of_best(), course.began)
                if course.blown or record[0] <= tolerance * course.losses[0]:
                    break
        except KeyboardInterrupt:
            raise self._cancelled("interrupted") from None
        finally:
            steps.close()
        if self.history and self._course().risen:
            warnings.warn(self._course().message(), DivergenceWarning, stacklevel=3)

    def _course(self) -> Course:
        """Losses since they mean the same."""
        start = min(int(self.work.number("stage")), len(self.history) - 1)
        return Course([step.loss for step in self.history[start:]], start)

    def _plan_of_best(self) -> Plan | None:
        """The plan of a run whose last light is of no use; None without any other."""
        self.work.best.unseen = None
        return self.plan() if "best" in self.work.memory else None

    def _cancelled(self, why: str) -> Cancelled:
        plan = self.plan() if self.history else None
        return Cancelled(
            f"{why} after {len(self.history)} iterations; pass the error's plan as resume= to go on from there", plan
        )

    def plan(self) -> Plan:
        work, before = self.work, self.resumed
        if before is not None and len(self.history) == len(before.history):
            return before
        light, window, iteration = work.best.choose(work)
        seconds = (before.seconds if before else 0.0) + time.perf_counter() - self.started
        return Plan(
            light,
            self.operator,
            self.method,
            tuple(self.history),
            window,
            work.pairs,
            self.method.papers,
            seconds,
            self.name,
            dict(work.memory),
            iteration,
        )


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
            f"got {method!r} as method; wanted a name ({', '.join(METHODS)}), a loss, or an instance such as OSMO()"
        )
    return method


def _limit(method: Method, iterations: int | None, pairs: float | None) -> int:
    """Iterations at most."""
    if iterations is not None:
        return _count(iterations)
    return method.iterations if pairs is None else ceil(positive("pairs", pairs))  # none takes less than one pair


def _count(iterations: int) -> int:
    if isinstance(iterations, bool):
        raise BadInput(f"iterations is {iterations!r}; expected a whole number ≥ 1")
    return counts("iterations", (iterations,), 1)[0]


def _name(target: Any) -> str:
    return str(getattr(target, "name", "target"))


def _memory(operator: Projector, method: Method, resume: Plan | None) -> dict[str, Any]:
    """A copy of what a plan remembers, so that the plan stays what it is."""
    if resume is None:
        return {}
    if resume.operator.device is not operator.device or resume.sinogram.shape != operator.range.shape:
        raise BadInput(
            f"the plan to resume has light {resume.sinogram.shape} on {resume.operator.device}; wanted "
            f"{operator.range.shape} on {operator.device}: resume with the operator that made it"
        )
    motion, poses = (getattr(one, "motion", None) for one in (resume.operator, operator))
    if motion != poses:
        raise BadInput(f"the plan to resume is for {motion!r}, the operator has {poses!r}; resume at the same angles")
    if resume.method != method:
        raise BadInput(f"the plan to resume is by {resume.method!r}, not by {method!r}; resume with the same method")
    return _copied(operator, resume.state)


def _copied(operator: Projector, value: Any) -> Any:
    if isinstance(value, DeviceArray):
        return combine(1.0, value, 0.0, value, operator.device.empty(value.shape))
    if isinstance(value, dict):
        return {name: _copied(operator, part) for name, part in value.items()}
    if isinstance(value, (list, tuple)):
        return type(value)(_copied(operator, part) for part in value)
    return value


@contextmanager
def _reporting(progress: bool | Progress | None, limit: int) -> Iterator[Progress]:
    """Where steps are reported: nowhere, to a function, or to a bar on the terminal."""
    if callable(progress):
        yield progress
    elif progress:
        from rich.progress import Progress as Bars

        with Bars() as bars:
            task = bars.add_task("optimizing", total=limit)
            yield lambda step: bars.update(
                task, completed=step.iteration, description=f"loss {step.loss:.3g}, window {step.window:+.3f}"
            )
    else:
        yield lambda step: None

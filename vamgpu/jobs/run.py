"""Carry out a job: target, light, frames, a folder; and prove a written one from its own bytes."""

from __future__ import annotations

import hashlib
import os
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from inspect import signature
from itertools import count
from math import inf
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from vamgpu.backend import open_device
from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.errors import (
    BadInput,
    Cancelled,
    ClusterWarning,
    JobError,
    MeshWarning,
    OutOfMemory,
    StorageError,
    WorkerLost,
)
from vamgpu.jobs.build import packing_of, projection_of, target_of, with_diffusion
from vamgpu.jobs.read import Job
from vamgpu.methods.saved import (
    IMPORTED,
    INTERRUPTED,
    PlanRecord,
    describe,
    operator_from,
    target_from,
    tolerances_from,
)
from vamgpu.operators.defocus import Defocused
from vamgpu.operators.ring_projection import RingProjection, against_rings, pays_on_rings
from vamgpu.printing.placement import FIT
from vamgpu.schema.registry import family, find, nearest
from vamgpu.storage.atomic import clear
from vamgpu.storage.folder import Folder, digest
from vamgpu.targets.target import Target

if TYPE_CHECKING:
    from vamgpu.methods.plan import Plan, Step
    from vamgpu.methods.tolerances import Tolerances
    from vamgpu.methods.tradeoff import ParetoPoint
    from vamgpu.printing.pack import Solved
    from vamgpu.printing.proof import Proof

CHECKPOINT = 300.0
"""Seconds of a run on a cluster after which its plan is kept: so much is lost with a worker, at most."""
RARELY = 10.0
"""Times as long as a run takes to begin, its plan is not kept again."""
TRIES = 100
"""How often a run goes on after workers were lost."""
BLOCK = 1 << 26
"""Bytes of a target that are hashed at once."""
StageProgress = Callable[[str, float], None]
"""Notified of progress: what is being done, and how much of it is done, 0..1."""


@dataclass(frozen=True, eq=False)
class Proven:
    """A proof and the record of the plan behind it.

    Args:
        proof: The proof.
        plan: How the light was found; without a history where this library did not.
    """

    proof: Proof
    plan: PlanRecord

    def report(self, path: str | Path) -> Path:
        """Write the report.

        Args:
            path: Where to, ending in .html.

        Returns:
            The path written.

        Raises:
            StorageError: The page cannot be written.
        """
        return self.proof.report(path, self.plan)


def _quietly(stage: str, share: float) -> None:
    """Tell nobody."""


def solve(
    job: Job, path: str | Path, *, overwrite: bool = False, start: str | Path | None = None, pareto: bool = False,
    cluster: str | None = None, progress: StageProgress = _quietly,
) -> Folder:  # fmt: skip
    """Find the light of a job, and write its folder, or go on with one that was interrupted.

    A run that is stopped by Ctrl-C leaves the plan it had reached, which can be proven; the next run goes on from it.

    Args:
        job: The job.
        path: The folder to write.
        overwrite: Replace a job folder that stands there.
        start: Folder of a plan whose light is the first guess, of as many angles and pixels. Where method and geometry
            are those of the job, and the run was interrupted, it goes on as if it never had been.
        pareto: Find the windows of shorter exposures too, and keep them for the report.
        cluster: As `vamgpu.jobs.cluster.slabs` takes it: its workers are then one device, and a run goes on from the
            last plan that was kept when one is lost. None for the job's own device.
        progress: Is told the stage and its share that is done.

    Returns:
        The folder.

    Raises:
        BadInput: A value of the job is out of range.
        MeshError: The mesh cannot be used.
        TargetTooLarge: The part reaches beyond the grid.
        DeviceError: The device is not there, or its memory is used up; or as `vamgpu.jobs.cluster.slabs`.
        StorageError: The folder cannot be written.
        Cancelled: On Ctrl-C; the folder holds the plan that was reached.
    """
    file, place = job.file, Path(path)
    for taken in (place, second(place)) if file.colors is not None else (place,):
        _refuse_taken(taken, overwrite)
    method, onward = file.method or _method(file.solve.method), start is None and not overwrite
    given: dict[str, Any] = {"overwrite": overwrite, "start": start, "pareto": pareto, "progress": progress}
    if cluster is None:
        return _solve(job, method, place, open_device(file.solve.device), kept=place if onward else None, **given)
    from vamgpu.jobs.cluster import slabs

    with slabs(cluster, file.solve.device) as made, _kept_on_the_way(place, onward) as kept:
        for tried in count():
            due = _Due(CHECKPOINT if file.colors is None else inf)
            try:
                return _solve(job, method, place, made(), kept=kept, due=due, **given)
            except WorkerLost as error:
                if tried >= TRIES or _while_stopped(error):
                    raise
                warnings.warn(f"{error}; going on from the plan that was kept last", ClusterWarning, stacklevel=2)
            except Cancelled:
                if not due.came:
                    raise
    raise AssertionError("counted to the end")


@contextmanager
def _kept_on_the_way(place: Path, onward: bool) -> Iterator[Path]:
    """Where plans are kept until a job is done: at its place, or beside it where other light stands that is to go."""
    if not os.path.lexists(place) or (onward and is_interrupted(place)):
        yield place
        return
    with TemporaryDirectory(prefix=f".{place.name}-", dir=place.parent) as beside:
        yield Path(beside) / place.name


def _while_stopped(error: BaseException | None) -> bool:
    """Whether an error came up while Ctrl-C was seen to."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__context__
    return error is not None


@dataclass
class _Due:
    """Whether it is time to keep a plan, so many seconds after the first iteration was begun.

    A run goes on from its plan as it began, so one that takes long to begin keeps its plan less often.
    """

    period: float
    came: bool = False
    made: float = field(default_factory=time.monotonic)
    begun: float | None = None

    def __call__(self) -> bool:
        now = time.monotonic()
        if self.begun is None:
            self.begun = now
        self.came = now - self.begun > max(self.period, RARELY * (self.begun - self.made))
        return self.came


def _solve(
    job: Job, method: Any, place: Path, device: Device, *, overwrite: bool, start: str | Path | None, pareto: bool,
    progress: StageProgress, kept: Path | None, due: _Due | None = None,
) -> Folder:  # fmt: skip
    """`solve` on a device. What is ``due`` is kept at ``kept``, which the run goes on from if it is there."""
    from vamgpu.printing.folder import save_frames
    from vamgpu.printing.pack import pack

    file = job.file
    packing = packing_of(file.frames, job.folder)
    progress("voxels", 0.0)
    target = target_of(job, device)
    inputs: dict[str, Any] = {
        "job": job.given, "print": None if file.print is None else file.print.model_dump()
    }  # fmt: skip
    if file.colors is not None:
        lights, record = _both(job, target, device, progress)
        inputs |= {"plan": asdict(record), "colors": {"strength": file.colors.strength}}
    else:
        try:
            begun = kept if kept is not None and is_interrupted(kept) else start
            lights = [_one(job, method, target, device, progress, begun, due)]
        except Cancelled as error:
            where = kept if kept is not None and due is not None and due.came else place
            if where != place or not os.path.lexists(place) or is_interrupted(place):
                _keep(error, where, inputs)
            raise
    if pareto:
        inputs["pareto"] = [asdict(point) for point in _traded(job, lights[0], progress)]
    progress("frames", 0.0)
    packed = [pack(light, **packing) for light in lights]
    progress("folder", 0.0)
    places = (place, second(place))
    folders = [
        save_frames(where, frames, inputs=inputs, overwrite=overwrite or is_interrupted(where))
        for frames, where in zip(packed, places, strict=False)
    ]
    return folders[0]


def _keep(error: Cancelled, place: Path, inputs: dict[str, Any]) -> None:
    """Write what an interrupted run had reached, so that the next one goes on from there."""
    from vamgpu.methods.saved import save_plan

    if error.plan is None:
        return
    plan: Any = error.plan
    save_plan(plan, place, inputs={**inputs, INTERRUPTED: len(plan.history)}, overwrite=True)


def is_interrupted(path: str | Path) -> bool:
    """Whether a folder holds the plan of a run that was stopped before its end.

    Args:
        path: The folder.

    Returns:
        The answer; False where there is no job.
    """
    try:
        return INTERRUPTED in Folder.open(path).manifest.inputs
    except StorageError:
        return False


def _one(
    job: Job, method: Any, target: Target, device: Device, progress: StageProgress, begun: str | Path | None,
    due: Callable[[], bool] | None = None,
) -> Plan:  # fmt: skip
    """The light of a job, found anew or from the light of an earlier plan on."""
    from vamgpu.methods import optimize
    from vamgpu.printing.pack import check_dither

    file, limit = job.file, job.file.solve.iterations or method.iterations
    light = projection_of(file, target, device, job.folder)
    A = with_diffusion(file, light, job.folder)
    if file.solve.operator != "voxels":
        light, A = (_on_rings(light, A, file.solve.operator == "rings"),) * 2
    describe(A, {})  # refuse what no manifest can describe, and no frames can show, before the long work
    check_dither(file.frames.dither, A, target)
    progress("light", 0.0)
    if file.resin.precompensate:  # the method itself lets the dose of the plain light diffuse
        method = replace(method, diffusion=A.inner.diffusion)
    solved = light if file.resin.precompensate else A
    lamp = {} if file.solve.exposure_limit is None else {"exposure_limit": file.solve.exposure_limit, **_lamp(job)}
    plan = optimize(
        solved, target, method=method, iterations=limit, tolerance=file.solve.tolerance,
        evaluations=file.solve.evaluations, tolerances=file.tolerances, progress=_share(progress, limit), cancel=due,
        **_onward(begun, solved, target, method, file.tolerances, lamp), **lamp,
    )  # fmt: skip
    return replace(plan, operator=A)


def _on_rings(light: Any, A: Any, asked: bool) -> Any:
    """The light of a job on rings, where they take it and are asked for or pay; else the operator as it is.

    Raises:
        JobError: They are asked for and do not take it.
    """
    rays: Any = light.operator if isinstance(light, Defocused) else light
    why = "the dose diffuses" if light is not A else against_rings(rays)
    if not why and (asked or pays_on_rings(rays)):
        try:
            on_rings = RingProjection.of(rays)
            return on_rings if rays is light else Defocused(on_rings, light.defocus, light.tolerance)
        except OutOfMemory:
            if asked:
                raise
            return A
    if asked:
        raise JobError(f'solve.operator: got "rings", which do not take this job: {why}; expected "voxels" or "auto"')
    return A


def _traded(job: Job, plan: Any, progress: StageProgress) -> tuple[ParetoPoint, ...]:
    """Windows of a job's light and of shorter exposures."""
    from vamgpu.methods.tradeoff import pareto

    if job.file.colors is not None:
        raise JobError("windows of shorter exposures are found for one color; leave --pareto or [colors] out")
    return pareto(plan, **_lamp(job), progress=lambda share: progress("pareto", share))


def _lamp(job: Job) -> dict[str, Any]:
    """Irradiance, critical dose and absorption of a job. Raises `JobError`."""
    if job.file.print is None:
        raise JobError("times need a lamp and a resin; add [print] with irradiance and critical_dose")
    return job.file.print.model_dump()


def _onward(
    place: str | Path | None, operator: Any, target: Target, method: Any, tolerances: Tolerances | None,
    lamp: dict[str, Any],
) -> dict[str, Any]:  # fmt: skip
    """How `optimize` goes on from a plan: where it stopped if all is the same, else with its light as the start."""
    from vamgpu.methods.limit import ExposureLimit
    from vamgpu.methods.saved import load_plan

    if place is None:
        return {}
    begun = load_plan(place, operator.device)
    limit = ExposureLimit.of(**lamp) if lamp else None
    bright = None if limit is None else limit.brightness(operator)
    same = begun.state and begun.method == method and begun.tolerances == tolerances
    same = same and begun.state.get("brightness") == bright
    if same and _known(begun.operator, begun.target) == _known(operator, target):
        return {"resume": replace(begun, operator=operator)}
    return {"start": begun.sinogram}


def _known(operator: Any, target: Any) -> tuple[Any, ...]:
    """What a plan is for, to be compared; a `Target`, or None."""
    arrays: dict[str, Any] = {}
    described = describe(operator, arrays)
    return described, {name: digest(values) for name, values in arrays.items()}, target and _seal(target)


def _seal(target: Target) -> str:
    """A hash of a target's fractions, which may be more than memory holds twice."""
    values, seal = target.fraction, hashlib.sha256()
    each = max(BLOCK // max(target.grid.shape[1] * target.grid.shape[2] * 4, 1), 1)
    for first in range(0, target.grid.shape[0], each):
        last = min(first + each, target.grid.shape[0])
        part = values.part(first, last) if isinstance(values, DeviceArray) else values[first:last]
        seal.update(np.ascontiguousarray(part, np.float32).view(np.uint8).data)
    return seal.hexdigest()


def _both(job: Job, target: Target, device: Device, progress: StageProgress) -> tuple[list[Solved], PlanRecord]:
    """The same for a job of two colors; one light where its rule sends no second."""
    from vamgpu.jobs.colors import recolored, recorded, superposed
    from vamgpu.printing.pack import Solved

    if job.file.solve.operator == "rings":
        raise JobError('solve.operator: got "rings", which take one color; expected "voxels" or "auto"')
    if job.file.frames.dither == FIT:
        raise JobError(f"frames.dither: got {FIT!r}, which knows the dose of one color; expected 'error-diffusion'")
    operators: list[Any] = []
    for file in (job.file, recolored(job.file)):
        light = projection_of(file, target, device, job.folder)
        operators.append(with_diffusion(file, light, job.folder))
        describe(operators[-1], {})
    progress("light", 0.0)
    plan = superposed(job.file, operators[0], operators[1], target, lambda share: progress("light", share))
    found = [
        Solved(light, A, target)
        for light, A in zip((plan.visible, plan.uv), operators, strict=True)
        if light is not None
    ]
    return found, recorded(plan, target)


def prove(
    path: str | Path, device: str | None = None, *, evaluations: float = 0.0, tolerances: bool = False,
    slices: tuple[int, int] | None = None, progress: StageProgress = _quietly,
) -> Proven:  # fmt: skip
    """Simulate a written job from its frames' bytes and gray curve.

    Args:
        path: The folder; that of the first of two colors stands for both.
        device: Device by name; None takes the best one.
        evaluations: Projector evaluations, of every corner, to find the widest window that any light can have; 0 leaves
            it unknown.
        tolerances: Prove it at every corner of the job's tolerances too, by rays traced for each; the widest window is
            then that at all of them.
        slices: First slice, and the one behind the last, that alone are asked for the widest window.
        progress: Is told the stage and its share that is done.

    Returns:
        The proof and the record of the plan.

    Raises:
        StorageError: The folder is missing, damaged or changed.
        DeviceError: The device is not there.
        BadInput: The widest window is asked for two colors, or by too few evaluations; or corners are, of a job without
            tolerances or of two colors.
    """
    from vamgpu.methods import bound
    from vamgpu.printing.corners import prove_corners
    from vamgpu.printing.folder import frames_of
    from vamgpu.printing.simulate import simulate

    folder, place = Folder.open(path), open_device(device)
    inputs = folder.manifest.inputs
    try:
        exposure, colors = dict(inputs.get("print") or {}), inputs.get("colors")
        strength = float(colors["strength"]) if colors else 0.0
        signature(simulate).bind(None, None, None, **exposure)
        record = PlanRecord.read(inputs.get("plan") or IMPORTED)
        record = replace(record, pareto=tuple(dict(point) for point in inputs.get("pareto") or ()))
    except (KeyError, TypeError, ValueError) as error:
        raise StorageError(
            f"{str(path)!r} lacks or garbles {error} in its manifest; write it with `vam solve`"
        ) from error
    progress("read", 0.0)
    try:
        A = operator_from(folder, place)
        target = target_from(folder, A.grid, place, solid=False)
        if mended := ((inputs.get("target") or {}).get("solid") or {}).get("mended"):
            warnings.warn(f"the mesh was mended before it was solved for: {'; '.join(map(str, mended))}", MeshWarning,
                          stacklevel=2)  # fmt: skip
        if target is None:
            raise StorageError(f"{str(path)!r} has no target to judge a print by; save the plan, or write the job with "
                               "`vam solve`")  # fmt: skip
        progress("frames", 0.0)
        frames = frames_of(folder, place)
        progress("proof", 0.0)
        proof = simulate(A, frames, target, progress=lambda share: progress("proof", share), **exposure)
        off = tolerances_from(folder) if tolerances else None
        if tolerances and (off is None or strength):
            what = "two colors" if strength else "no tolerances"
            raise BadInput(f"{str(path)!r} has {what}; expected [tolerances] in the job it was solved for, and one "
                           "color")  # fmt: skip
        if evaluations:
            if strength:
                raise BadInput(f"{str(path)!r} has two colors, whose doses no bound is known for; prove it without one")
            progress("bound", 0.0)
            most = evaluations * (len(off.corners()) if off is not None else 1)
            found = bound(
                A, target, evaluations=most, tolerances=off, slices=slices, progress=_spent(progress, most)
            )  # fmt: skip
            proof = replace(proof, bound=found)
        if off is not None:
            proof = replace(proof, corners=prove_corners(A, frames, target, off))
        if strength and os.path.exists(second(Path(path))):
            from vamgpu.jobs.colors import subtracted

            beside = Folder.open(second(Path(path)))
            proof = subtracted(proof, strength, operator_from(beside, place), frames_of(beside, place))
    except MemoryError as error:
        raise OutOfMemory(f"the light of {str(path)!r} takes more memory than there is: {error}; check its manifest, "
                          "or prove it on a larger machine") from error  # fmt: skip
    return Proven(proof, record)


def second(path: Path) -> Path:
    """The folder of the second color beside that of the first: boat.vam and boat-uv.vam."""
    return path.with_name(f"{path.stem}-uv{path.suffix}")


def _refuse_taken(place: Path, overwrite: bool) -> None:
    """Say before the work, not after it, that the place is taken."""
    clear(place)
    if os.path.lexists(place) and not overwrite and not is_interrupted(place):
        raise StorageError(f"{str(place)!r} exists; choose another path, or allow overwriting it (--overwrite)")


def _method(name: str) -> Any:
    """The method of that name with its default parameters."""
    methods = family("method")
    known = ("default", *methods.nouns)
    if name not in known:
        raise JobError(f"solve.method: got {name!r}; expected one of {', '.join(known)}{nearest(name, known)}")
    return find("method", "best" if name == "default" else name)()


def _share(progress: StageProgress, limit: int) -> Callable[[Step], None]:
    """An optimizer's steps as a share of its iterations."""
    return lambda step: progress("light", step.iteration / limit)


def _spent(progress: StageProgress, evaluations: float) -> Callable[[Step], None]:
    """The steps of a bound as a share of its evaluations."""
    return lambda step: progress("bound", min(step.evaluations / evaluations, 1.0))

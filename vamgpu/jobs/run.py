"""Solve a job: target, patterns, frames, folder; and prove a job folder from its bytes."""

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
from typing import Any

import numpy as np

from vamgpu.backend import open_device
from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.chemistry.oxygen import OxygenModel
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
from vamgpu.jobs.cluster import slabs
from vamgpu.jobs.colors import recolored, recorded, subtracted, superposed
from vamgpu.jobs.estimate import expected
from vamgpu.jobs.model import JobFile
from vamgpu.jobs.read import Job
from vamgpu.methods import bound, optimize
from vamgpu.methods.choice import EFFECTIVE, chosen
from vamgpu.methods.limit import ExposureLimit
from vamgpu.methods.plan import Plan, Step
from vamgpu.methods.plan_folder import (
    IMPORTED,
    INTERRUPTED,
    PlanRecord,
    describe,
    load_plan,
    operator_from,
    save_plan,
    target_from,
    tolerances_from,
)
from vamgpu.methods.surface import finer_voxels
from vamgpu.methods.tolerances import Corner, Tolerances, at
from vamgpu.methods.tradeoff import ParetoPoint, pareto
from vamgpu.operators.defocus import Defocused
from vamgpu.operators.projector import with_algorithm
from vamgpu.operators.ring_projection import unsupported_reason
from vamgpu.printing.corners import prove_corners
from vamgpu.printing.folder import frames_of, save_frames
from vamgpu.printing.pack import Solved, check_dither, pack
from vamgpu.printing.placement import FIT
from vamgpu.printing.proof import Proof
from vamgpu.printing.simulate import simulate
from vamgpu.schema import write
from vamgpu.schema.read import read
from vamgpu.storage.atomic import clear
from vamgpu.storage.folder import Folder, check_place, digest
from vamgpu.storage.reading import malformed
from vamgpu.targets.target import Target

CHECKPOINT = 300.0  # interval at which a run on a cluster saves its plan [s]: the most that is lost with a worker
RARELY = 10.0  # shortest interval between saved plans, relative to the time that the run takes to start
TRIES = 100  # number of times that a run continues after workers were lost
BLOCK = 1 << 26  # bytes of a target that are hashed at a time
StageProgress = Callable[[str, float], None]  # receives progress: the stage, and the share of it that is done, 0..1


@dataclass(frozen=True, eq=False)
class Proven:
    proof: Proof
    plan: PlanRecord

    def report(self, path: str | Path) -> Path:
        """Write the report. Raises `StorageError`."""
        return self.proof.report(path, self.plan)


def quiet(stage: str, share: float) -> None:
    """Ignore progress."""


def solve(
    job: Job, path: str | Path, *, overwrite: bool = False, start: str | Path | None = None, pareto: bool = False,
    cluster: str | None = None, progress: StageProgress = quiet,
) -> Folder:  # fmt: skip
    """Optimize the patterns of a job and write its folder, or resume an interrupted run."""
    file, place = job.file, Path(path)
    for taken in (place, uv_folder(place)) if file.colors is not None else (place,):
        clear(taken)
        check_place(taken, overwrite=overwrite or is_interrupted(taken))
    method, onward = file.method or _method(file), start is None and not overwrite
    given: dict[str, Any] = {"overwrite": overwrite, "start": start, "pareto": pareto, "progress": progress}
    if cluster is None:
        return _solve(job, method, place, open_device(file.solve.device), kept=place if onward else None, **given)
    with slabs(cluster, file.solve.device) as made, _kept_on_the_way(place, onward) as kept:
        for tried in count():
            due = _Due(CHECKPOINT if file.colors is None else inf)
            try:
                return _solve(job, method, place, made(), kept=kept, due=due, **given)
            except WorkerLost as error:
                if tried >= TRIES or _while_stopped(error):
                    raise
                warnings.warn(f"{error}; continuing from the plan that was saved last", ClusterWarning, stacklevel=2)
            except Cancelled:
                if not due.came:
                    raise
    raise AssertionError("counted to the end")


@contextmanager
def _kept_on_the_way(place: Path, onward: bool) -> Iterator[Path]:
    """Folder in which plans are saved until a job is done: the job's own, or one beside it to replace patterns."""
    if not os.path.lexists(place) or (onward and is_interrupted(place)):
        yield place
        return
    with TemporaryDirectory(prefix=f".{place.name}-", dir=place.parent) as beside:
        yield Path(beside) / place.name


def _while_stopped(error: BaseException | None) -> bool:
    """Whether an error occurred while Ctrl-C was handled."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__context__
    return error is not None


@dataclass
class _Due:
    """Whether to save a plan at a given number of seconds after the start of the first iteration."""

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
    """`solve` on a device. Plans that are ``due`` are saved at ``kept``; a run continues from an existing ``kept``."""
    file = job.file
    packing = packing_of(file.frames, job.folder)
    progress("voxels", 0.0)
    target = target_of(job, device)
    inputs: dict[str, Any] = {
        "job": job.given, "print": None if file.print is None else file.print.model_dump()
    }  # fmt: skip
    if file.colors is not None:
        lights, record = _both(job, target, device, progress)
        inputs |= {
            "plan": asdict(record),
            "colors": {"strength": file.colors.strength, "rule": write(file.colors.rule)},
        }
    else:
        try:
            begun = kept if kept is not None and is_interrupted(kept) else start
            lights = [_one(job, method, target, device, progress, begun, due)]
        except Cancelled as error:
            where = kept if kept is not None and due is not None and due.came else place
            _keep(error.plan, where, inputs, where != place)
            raise
    try:
        if pareto:
            inputs["pareto"] = [asdict(point) for point in _traded(job, lights[0], progress)]
        progress("frames", 0.0)
        packed = [pack(light, **packing) for light in lights]
    except KeyboardInterrupt:
        if file.colors is None:
            _keep(lights[0], place, inputs)
        raise
    progress("folder", 0.0)
    places = (place, uv_folder(place))
    folders = [
        save_frames(where, frames, inputs=inputs, overwrite=overwrite or is_interrupted(where))
        for frames, where in zip(packed, places, strict=False)
    ]
    return folders[0]


def _keep(plan: Any, place: Path, inputs: dict[str, Any], anywhere: bool = False) -> None:
    """Save the plan of an interrupted run for the next run, unless another job is at that place."""
    if plan is not None and (anywhere or not os.path.lexists(place) or is_interrupted(place)):
        save_plan(plan, place, inputs={**inputs, INTERRUPTED: len(plan.history)}, overwrite=True)


def is_interrupted(path: str | Path) -> bool:
    """Whether a folder holds the plan of an interrupted run."""
    try:
        return INTERRUPTED in Folder.open(path).manifest.inputs
    except StorageError:
        return False


def _one(
    job: Job, method: Any, target: Target, device: Device, progress: StageProgress, begun: str | Path | None,
    due: Callable[[], bool] | None = None,
) -> Plan:  # fmt: skip
    """Optimize the patterns of a job, from the start or from an earlier plan."""
    file = job.file
    limit = file.solve.iterations or method.iterations
    light = projection_of(file, target, device, job.folder)
    A = with_diffusion(file, light, job.folder)
    rings = file.solve.operator == "rings"
    free = file.solve.operator == "auto" and finer_voxels(method, A, target) is None  # else the method chooses
    if (rings or free) and file.scattering is None:  # which is on rings already
        light, A = (_on_rings(light, A, rings),) * 2
    describe(A, {})  # before the long computation, reject what a manifest cannot describe or frames cannot show
    check_dither(file.frames.dither, A, target, file.frames.bits)
    if (tell := getattr(progress, "tell", None)) is not None:
        progress("rays", 0.0)
        corners = 1 if file.tolerances is None else len(file.tolerances.corners())
        tell(str(expected(A, target, method, file.solve.evaluations or limit * method.cost * corners, corners)))
    progress("light", 0.0)
    if file.resin.precompensate:  # the method itself applies diffusion to the dose
        method = replace(method, diffusion=A.inner.diffusion)
    solved = light if file.resin.precompensate else A
    seconds = file.solve.exposure_limit
    if isinstance(A, OxygenModel) and file.print is not None:
        seconds = A.oxygen.seconds
    lamp = {} if seconds is None else {"exposure_limit": seconds, **_lamp(job)}
    plan = optimize(
        solved, target, method=method, iterations=limit, tolerance=file.solve.tolerance,
        evaluations=file.solve.evaluations, tolerances=file.tolerances, cancel=due,
        progress=_Steps(progress, limit),
        **_onward(begun, solved, target, method, file.tolerances, lamp), **lamp,
    )  # fmt: skip
    return replace(plan, operator=A)


class _Steps:
    """Reports steps as a share of their number, and in full where progress takes them."""

    def __init__(self, progress: StageProgress, limit: int) -> None:
        self._progress, self._limit = progress, limit
        self._step: Callable[[Step], None] = getattr(progress, "step", lambda step: None)
        self.look = getattr(progress, "look", None)

    def __call__(self, step: Step) -> None:
        self._step(step)
        self._progress("light", step.iteration / self._limit)


def _on_rings(light: Any, A: Any, asked: bool) -> Any:
    """The operator of a job on rings, if they are required or faster. Raises `JobError` if they cannot be used."""
    rays = light.operator if isinstance(light, Defocused) else light
    why = "the dose diffuses" if light is not A else unsupported_reason(rays)
    if asked and why:
        raise JobError(f'solve.operator: got "rings", which cannot run this job: {why}; expected "voxels" or "auto"')
    return A if why else with_algorithm(light, "rings" if asked else "auto")


def _traded(job: Job, plan: Any, progress: StageProgress) -> tuple[ParetoPoint, ...]:
    """Windows of a job's patterns and of shorter exposures."""
    if job.file.colors is not None:
        raise JobError("windows of shorter exposures need one color; leave out --pareto or [colors]")
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
    """Arguments of `optimize` that resume the plan of the same job, or start from the patterns of another."""
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
    """Comparable description of a plan's operator and target."""
    arrays: dict[str, Any] = {}
    described = describe(operator, arrays)
    return described, {name: digest(values) for name, values in arrays.items()}, target and _seal(target)


def _seal(target: Target) -> str:
    """A hash of a target's fractions, without a second copy in memory."""
    values, seal = target.fraction, hashlib.sha256()
    each = max(BLOCK // max(target.grid.shape[1] * target.grid.shape[2] * 4, 1), 1)
    for first in range(0, target.grid.shape[0], each):
        last = min(first + each, target.grid.shape[0])
        part = values.part(first, last) if isinstance(values, DeviceArray) else values[first:last]
        seal.update(np.ascontiguousarray(part, np.float32).view(np.uint8).data)
    return seal.hexdigest()


def _both(job: Job, target: Target, device: Device, progress: StageProgress) -> tuple[list[Solved], PlanRecord]:
    """The same for a job of two colors; one set of patterns if its rule has no second color."""
    if job.file.solve.operator == "rings":
        raise JobError('solve.operator: got "rings", which support one color; expected "voxels" or "auto"')
    if job.file.frames.dither == FIT:
        raise JobError(f"frames.dither: got {FIT!r}, which supports one color; expected 'error-diffusion'")
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
    slices: tuple[int, int] | None = None, coarse: bool = False, off: Corner | None = None,
    progress: StageProgress = quiet,
) -> Proven:  # fmt: skip
    """Simulate a job folder from the bytes and the gray curve of its frames; ``off``: on a machine with these errors.

    With errors, the exposure is that of the print without them.
    """
    folder, place = Folder.open(path), open_device(device)
    record, exposure, strength = _recorded(folder)
    within = tolerances_from(folder) if tolerances else None
    if strength and (tolerances or evaluations or off is not None):
        raise BadInput(f"{str(path)!r} has two colors; prove it without --bound, --tolerances and --off")
    if tolerances and within is None:
        raise BadInput(f"{str(path)!r} has no tolerances; solve it again with [tolerances], or leave out --tolerances")
    progress("read", 0.0)
    try:
        A = operator_from(folder, place)
        target = _judged_target(folder, A, place)
        progress("frames", 0.0)
        frames = frames_of(folder, place)
        progress("proof", 0.0)
        settings: dict[str, Any] = {"coarse": coarse, "progress": lambda share: progress("proof", share)}
        if isinstance(A, OxygenModel) and (evaluations or off is not None):
            raise BadInput(f"{str(path)!r} models oxygen; prove it without --bound and --off")
        if off is not None:
            usual = simulate(A, frames, target, **settings, **exposure).scores.threshold
            A, settings["threshold"] = at(A, off), usual / (1.0 + off.dose)
        proof = replace(simulate(A, frames, target, **settings, **exposure), history=record.history, off=off)
        if evaluations:
            progress("bound", 0.0)
            most = evaluations * (len(within.corners()) if within is not None else 1)
            widest = bound(A, target, evaluations=most, tolerances=within, slices=slices,
                           progress=lambda step: progress("bound", min(step.evaluations / most, 1.0)))  # fmt: skip
            proof = replace(proof, bound=widest)
        if within is not None:
            proof = replace(proof, corners=prove_corners(A, frames, target, within))
        if strength and not coarse and os.path.exists(uv_folder(Path(path))):
            beside = Folder.open(uv_folder(Path(path)))
            rule = read("rule", (folder.manifest.inputs["colors"] or {}).get("rule") or {}, units=False)
            proof = subtracted(proof, strength, rule, operator_from(beside, place), frames_of(beside, place))
    except MemoryError as error:
        raise OutOfMemory(f"the patterns of {str(path)!r} need more memory than there is: {error}; check its manifest, "
                          "or prove it on a larger machine") from error  # fmt: skip
    return Proven(proof, record)


def _recorded(folder: Folder) -> tuple[PlanRecord, dict[str, Any], float]:
    """Plan, lamp and resin, and strength of a second color (0 without one), from a manifest. Raises `StorageError`."""
    inputs = folder.manifest.inputs
    with malformed(f"the manifest of {str(folder.path)!r} is malformed", "write the job with `vam solve`"):
        exposure, colors = dict(inputs.get("print") or {}), inputs.get("colors")
        signature(simulate).bind(None, None, None, **exposure)
        record = PlanRecord.read(inputs.get("plan") or IMPORTED)
        record = replace(record, pareto=tuple(dict(point) for point in inputs.get("pareto") or ()))
        return record, exposure, float(colors["strength"]) if colors else 0.0


def _judged_target(folder: Folder, A: Any, device: Device) -> Target:
    """The target of a job folder; warns of a repaired mesh. Raises `StorageError`."""
    target = target_from(folder, A.grid, device)
    if mended := ((folder.manifest.inputs.get("target") or {}).get("solid") or {}).get("mended"):
        warnings.warn(f"the mesh was repaired before solving: {'; '.join(map(str, mended))}", MeshWarning,
                      stacklevel=3)  # fmt: skip
    if target is None:
        raise StorageError(f"{str(folder.path)!r} has no target to compare a print with; save the plan, pass its "
                           "target to pack, or write the job with `vam solve`")  # fmt: skip
    return target


def uv_folder(path: Path) -> Path:
    """The folder of the second color beside that of the first: boat.vam and boat-uv.vam."""
    return path.with_name(f"{path.stem}-uv{path.suffix}")


def _method(file: JobFile) -> Any:
    """The method that a job names, with its default parameters."""
    if file.resin.oxygen is not None and file.solve.method == "default":
        return EFFECTIVE
    try:
        return chosen(file.solve.method)
    except BadInput as error:
        raise JobError(f"solve.method: {error}") from None

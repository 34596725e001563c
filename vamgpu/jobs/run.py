"""Carry out a job: target, light, frames, a folder; and prove a written one from its own bytes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vamgpu.backend import open_device
from vamgpu.errors import JobError, StorageError
from vamgpu.jobs.build import describe, packing_of, projection_from, projection_of, target_of, with_diffusion
from vamgpu.jobs.read import Job
from vamgpu.jobs.record import PlanRecord
from vamgpu.schema.registry import family, find, nearest
from vamgpu.storage.folder import Entry, Folder
from vamgpu.targets.target import Target

if TYPE_CHECKING:
    from vamgpu.methods.plan import Step
    from vamgpu.printing.proof import Proof

Told = Callable[[str, float], None]
"""Told of progress: what is being done, and how much of it is done, 0..1."""


@dataclass(frozen=True, eq=False)
class Proven:
    """A proof and the record of the plan behind it."""

    proof: Proof
    plan: PlanRecord

    def report(self, path: str | Path) -> Path:
        """Write the report; raises `StorageError`."""
        return self.proof.report(path, self.plan)


def _quietly(stage: str, share: float) -> None:
    """Tell nobody."""


def solve(job: Job, path: str | Path, *, overwrite: bool = False, told: Told = _quietly) -> Folder:
    """Find the light of a job, pack it, and write its folder, whole or not at all.

    Raises what the parts raise: `BadInput`, `MeshError`, `TargetTooLarge`, `DeviceError`, `StorageError`.
    """
    from vamgpu.methods import optimize
    from vamgpu.printing.folder import save_frames
    from vamgpu.printing.pack import pack

    wanted = job.wanted
    _refuse_taken(Path(path), overwrite)
    method = wanted.method or _method(wanted.solve.method)
    limit = wanted.solve.iterations or method.iterations
    device = open_device(wanted.solve.device)
    packing = packing_of(wanted.frames, job.folder)
    told("voxels", 0.0)
    target = target_of(job, device)
    light = projection_of(wanted, target, device, job.folder)
    A = with_diffusion(wanted, light, job.folder)
    geometry = describe(A)  # refuse what no manifest can describe before the long work
    told("light", 0.0)
    if wanted.resin.precompensate:  # the method itself lets the dose of the plain light diffuse
        method, solved = replace(method, diffusion=A.inner.diffusion), light
    else:
        solved = A
    plan = optimize(
        solved, target, method=method, iterations=limit, tolerance=wanted.solve.tolerance, pairs=wanted.solve.pairs,
        progress=_share(told, limit),
    )  # fmt: skip
    told("frames", 0.0)
    frames = pack(plan, **packing)
    told("folder", 0.0)
    inputs = {
        "job": job.given,
        "geometry": geometry,
        "target": {key: getattr(target, key) for key in ("name", "radius", "volume", "height")},
        "plan": asdict(PlanRecord.of(plan)),
        "print": None if wanted.print is None else wanted.print.model_dump(),
    }
    arrays = {"target": Entry(target.on(device), ("x", "y", "z"))}
    return save_frames(path, frames, inputs=inputs, arrays=arrays, overwrite=overwrite)


def prove(path: str | Path, device: str | None = None) -> Proven:
    """Simulate a written job from its frames' bytes and gray curve. Raises `StorageError`, `DeviceError`."""
    from vamgpu.printing.folder import load_frames
    from vamgpu.printing.simulate import simulate

    folder, place = Folder.open(path), open_device(device)
    inputs = folder.manifest.inputs
    try:
        geometry, part, plan, exposure = (inputs[key] for key in ("geometry", "target", "plan", "print"))
        name, facts = part["name"], {key: float(part[key]) for key in ("radius", "volume", "height")}
    except (KeyError, TypeError) as error:
        raise StorageError(f"{str(path)!r} lacks {error} in its manifest; write it with `vam solve`") from error
    A = projection_from(geometry, place)
    target = Target(A.grid, name, folder.array("target"), facts["radius"], facts["volume"], facts["height"])
    proof = simulate(A, load_frames(path, place), target, **(exposure or {}))
    return Proven(proof, PlanRecord.read(plan))


def _refuse_taken(place: Path, overwrite: bool) -> None:
    """Say before the work, not after it, that the place is taken."""
    if place.exists() and not overwrite:
        raise StorageError(f"{str(place)!r} exists; choose another path, or allow overwriting it (--overwrite)")


def _method(name: str) -> Any:
    """The method of that name with its default parameters."""
    methods = family("method")
    known = ("default", *methods.nouns)
    if name not in known:
        raise JobError(f"solve.method: got {name!r}; wanted one of {', '.join(known)}{nearest(name, known)}")
    return find("method", str(methods.default) if name == "default" else name)()


def _share(told: Told, limit: int) -> Callable[[Step], None]:
    """An optimizer's steps as a share of its iterations."""
    return lambda step: told("light", step.iteration / limit)

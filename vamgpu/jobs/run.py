"""Carry out a job: target, light, frames, a folder; and prove a written one from its own bytes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vamgpu.backend import open_device
from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
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
    from vamgpu.printing.folder import save_frames
    from vamgpu.printing.pack import pack

    wanted, place = job.wanted, Path(path)
    for taken in (place, second(place)) if wanted.colors is not None else (place,):
        _refuse_taken(taken, overwrite)
    method = wanted.method or _method(wanted.solve.method)
    device = open_device(wanted.solve.device)
    packing = packing_of(wanted.frames, job.folder)
    told("voxels", 0.0)
    target = target_of(job, device)
    lights, record = (_both if wanted.colors is not None else _one)(job, method, target, device, told)
    told("frames", 0.0)
    packed = [pack(light, **packing) for light in lights]
    told("folder", 0.0)
    inputs = {
        "job": job.given,
        "target": {key: getattr(target, key) for key in ("name", "radius", "volume", "height")},
        "plan": asdict(record),
        "print": None if wanted.print is None else wanted.print.model_dump(),
    }
    if wanted.colors is not None:
        inputs["colors"] = {"strength": wanted.colors.strength}
    arrays = {"target": Entry(target.on(device), ("x", "y", "z"))}
    folders = []
    for light, frames, where in zip(lights, packed, (place, second(place)), strict=False):
        own = {**inputs, "geometry": describe(light.operator)}
        folders.append(save_frames(where, frames, inputs=own, arrays=arrays, overwrite=overwrite))
    return folders[0]


@dataclass(frozen=True, eq=False)
class _Light:
    """Light and the operator that makes dose of it, as `pack` takes them."""

    sinogram: DeviceArray
    operator: Any


def _one(job: Job, method: Any, target: Target, device: Device, told: Told) -> tuple[list[_Light], PlanRecord]:
    """The light of a job, and what is remembered of how it was found."""
    from vamgpu.methods import optimize

    wanted, limit = job.wanted, job.wanted.solve.iterations or method.iterations
    light = projection_of(wanted, target, device, job.folder)
    A = with_diffusion(wanted, light, job.folder)
    describe(A)  # refuse what no manifest can describe before the long work
    told("light", 0.0)
    if wanted.resin.precompensate:  # the method itself lets the dose of the plain light diffuse
        method = replace(method, diffusion=A.inner.diffusion)
    plan = optimize(
        light if wanted.resin.precompensate else A, target, method=method, iterations=limit,
        tolerance=wanted.solve.tolerance, pairs=wanted.solve.pairs, progress=_share(told, limit),
    )  # fmt: skip
    return [_Light(plan.sinogram, A)], PlanRecord.of(plan)


def _both(job: Job, method: Any, target: Target, device: Device, told: Told) -> tuple[list[_Light], PlanRecord]:
    """The same for a job of two colors; one light where its rule sends no second."""
    from vamgpu.jobs.colors import recolored, recorded, superposed

    operators: list[Any] = []
    for wanted in (job.wanted, recolored(job.wanted)):
        light = projection_of(wanted, target, device, job.folder)
        operators.append(with_diffusion(wanted, light, job.folder))
        describe(operators[-1])
    told("light", 0.0)
    plan = superposed(job.wanted, operators[0], operators[1], target, lambda share: told("light", share))
    found = [_Light(light, A) for light, A in zip((plan.visible, plan.uv), operators, strict=True) if light is not None]
    return found, recorded(plan, target)


def prove(path: str | Path, device: str | None = None) -> Proven:
    """Simulate a written job from its frames' bytes and gray curve. Raises `StorageError`, `DeviceError`.

    The folder of the first of two colors stands for both.
    """
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
    if inputs.get("colors") and second(Path(path)).exists():
        from vamgpu.jobs.colors import subtracted

        other = second(Path(path))
        B = projection_from(Folder.open(other).manifest.inputs["geometry"], place)
        proof = subtracted(proof, float(inputs["colors"]["strength"]), B, load_frames(other, place))
    return Proven(proof, PlanRecord.read(plan))


def second(path: Path) -> Path:
    """The folder of the second color beside that of the first: boat.vam and boat-uv.vam."""
    return path.with_name(f"{path.stem}-uv{path.suffix}")


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

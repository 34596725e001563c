"""Proof of a run: the recorded light in the simulation of its job."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, StorageError, VamError
from vamgpu.hosts.records.account import LightAccount, account
from vamgpu.hosts.records.plans import kept_frames
from vamgpu.hosts.records.record import RunRecord, digest, read_run
from vamgpu.jobs.run import Proven, prove
from vamgpu.operators.follow import followed
from vamgpu.printing.frames import Frames
from vamgpu.printing.given_dose import GivenDose
from vamgpu.printing.proof import Proof
from vamgpu.printing.simulate import ShownLight, simulate
from vamgpu.targets.target import Target


@dataclass(frozen=True, eq=False)
class ShownFrames:
    """Frames as a run showed them."""

    frames: Frames  # frames of the job
    share: np.ndarray  # share of each frame's light, (frames,), or of its rows, (frames, rows)
    versions: tuple[tuple[Callable[[], Frames], np.ndarray], ...] = ()  # readers of replaced frames, and their shares

    @property
    def scale(self) -> float:
        """Irradiance of a full-on pixel."""
        return self.frames.scale

    @property
    def motion(self) -> Any:
        return self.frames.motion

    def irradiance(self, device: Device) -> DeviceArray:
        """Light [angle, r, z] of the run, per turn of the plan."""
        light = self.frames.irradiance(device).numpy() * self.share.reshape(len(self.share), 1, -1)
        for frames, share in self.versions:  # one by one, because there may be many
            light += frames().irradiance(device).numpy() * share[:, None, None]
        return device.upload(light.astype(np.float32))


def _jobs(run: RunRecord, given: Sequence[str | Path]) -> list[Path]:
    """Job folders of the projectors. Raises `BadInput` for jobs of other prints, `StorageError`."""
    printed, moved = run.asked["digests"], {digest(Path(each)): Path(each) for each in given}
    if others := [str(place) for known, place in moved.items() if known not in printed]:
        raise BadInput(f"the job {others[0]!r} was not printed here; give the printed one (--job)")
    found = []
    for path, known in zip(run.asked["jobs"], printed, strict=True):
        places = [moved[known]] if known in moved else [Path(path), run.path.parent / Path(path).name]
        place = next((each for each in places if each.exists()), None)
        if place is None:
            raise StorageError(f"the job {path!r} of this run is missing; give its new folder (--job)")
        if digest(place) != known:
            raise BadInput(f"the job {str(place)!r} has changed since the print; give the printed one (--job)")
        found.append(place)
    return found


@dataclass(frozen=True, eq=False)
class RunProof:
    """The print of one projector of a run; least and most are the same if all its light is known."""

    run: RunRecord
    light: LightAccount  # light of all views
    planned: Proven  # the proof of the job itself
    least: Proof  # proof of the shown frames, without uncertain light
    most: Proof  # with all uncertain light


def prove_run(
    path: str | Path, device: str | None = None, job: str | Path | Sequence[str | Path] = ()
) -> tuple[RunProof, ...]:
    """Prove the print of a vial's run from its recorded light. Raises `BadInput`, `StorageError`."""
    # One proof for each projector.  job: folders of moved jobs, in any order; by default at their old place
    # or beside the run.
    run = read_run(path)
    try:
        light = account(run)
        jobs = _jobs(run, (job,) if isinstance(job, (str, Path)) else job)
    except VamError:
        raise
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise StorageError(f"the record of {str(path)!r} is malformed: {error!r}; its folder was changed") from error
    if light is None or run.asked.get("kind") != "vial":
        raise BadInput(f"{str(path)!r} has no record of a vial's frames; only runs of vials can be proved")
    if not light.sure.any():
        raise BadInput(f"{str(path)!r} has shown nothing; there is no light to prove")
    found = []
    for engine, place in enumerate(jobs):
        planned = prove(place, device)
        proof = planned.proof
        doubts = (0.0, 1.0) if any(one.unsure[engine].any() for one in (light, *light.versions.values())) else (0.0,)
        shown = [prove_given(proof, shown_frames(run, light, proof, engine, unsure), light.dose) for unsure in doubts]
        found.append(RunProof(run, light, planned, shown[0], shown[-1]))
    return tuple(found)


def shown_frames(
    run: RunRecord, light: LightAccount, proof: Proof, engine: int = 0, unsure: float = 0.0
) -> ShownFrames:  # fmt: skip
    """The frames shown by a projector: the job's, and those of versions that replaced them."""
    job = proof.frames
    if not light.versions:
        share, motion = light.share(unsure)[engine], job.motion
        path = None if motion is None or motion.travel is None else followed(motion, proof.operator.beam)
        if path is not None:  # each turn has frames of its own
            share = (path.lit * share.reshape(*path.lit.shape[:2], 1)).sum(axis=0) / path.repeats
        return ShownFrames(job, share)
    planned = account(run, versions=False)
    assert planned is not None
    wanted = np.maximum(planned.wanted[engine], 1)  # over all turns of the plan
    share = {n: (each.sure[engine] + unsure * each.unsure[engine]) / wanted for n, each in light.versions.items()}
    others = ((partial(kept_frames, run.path, number, engine, job.device), share[number]) for number in share if number)
    return ShownFrames(job, share.get(0, np.zeros(job.shape[0])), tuple(others))


def prove_given(known: Proof, frames: ShownLight, dose: GivenDose | None) -> Proof:
    """Prove the frames that a print showed, at the dose that it gave."""
    whole = Target.from_array(known.target.numpy(), known.operator.grid.pitch, known.name)
    target = replace(whole, solid=known.solid, limits=known.limits)
    threshold = None if dose is None else known.scores.threshold / dose.share
    proof = simulate(known.operator, frames, target, threshold=threshold)
    if dose is None:
        return proof
    got = proof.scores.total_in / known.scores.total_in
    return replace(proof, given=replace(dose, share=dose.share * got))

"""The folder of a plan's run: begun, or gone on with where a host left it, of the same jobs on the same rig."""

from __future__ import annotations

from hashlib import sha256
from pathlib import Path
from typing import Any

from vamgpu.errors import BadInput
from vamgpu.hosts.players.cable import VideoMachines
from vamgpu.hosts.players.mirrors import Machines
from vamgpu.hosts.record import Run, RunFolder, read_run
from vamgpu.hosts.resume import Interrupted, interrupted, left_in
from vamgpu.hosts.rigs.config import RigConfig, RigFile, parse_rig
from vamgpu.hosts.rigs.planning import Plan
from vamgpu.hosts.run import Limits
from vamgpu.storage.atomic import explained


def limits(rig: RigConfig) -> Limits:
    """What the rig's file says of safety."""
    said = rig.wanted.safety
    return Limits(round(said.lease * 1e9), said.tolerance, said.budget, round(said.resume * 1e9))


def asked_for(planned: Plan) -> dict[str, Any]:
    """What a run's folder keeps of its plan."""
    table, jobs = planned.schedule, [each.path for each in planned.works]
    return {
        "jobs": jobs, "digests": [_digest(Path(job)) for job in jobs], "kind": planned.kind, "rig": planned.rig.source,
        "slots": len(table), "unit": table.unit, "speed": float(table.speed),
        "stop": None if planned.stop is None else planned.stop.threshold, "settings": planned.rig.settings,
    }  # fmt: skip


def _digest(job: Path) -> str:
    """Of what a job's folder says of its frames; of the names and sizes of slices."""
    manifest = job / "manifest.json"
    if manifest.is_file():
        return sha256(manifest.read_bytes()).hexdigest()
    files = sorted((file.name, file.stat().st_size) for file in job.iterdir()) if job.is_dir() else []
    return sha256(repr(files or job.name).encode()).hexdigest()


def may_go_on(planned: Plan, folder: str | Path) -> None:
    """Raise `BadInput`, `StorageError` where a folder holds no print of this plan that could be gone on with.

    Ask before machines are opened: what the folders tell needs none of them.
    """
    if planned.display is not None:
        raise BadInput(
            "a video projector went on with its last picture while the vial turned, until the lease was over: this "
            "print cannot be gone on with; begin it anew with fresh resin"
        )
    before = read_run(folder)
    asked, wanted = before.asked, asked_for(planned)
    names = ("digests", "kind", "slots", "speed", "stop")
    if different := [name for name in names if name in asked and asked[name] != wanted[name]]:
        told = ", ".join(f"{name} {asked.get(name)!r} in place of {wanted[name]!r}" for name in different)
        raise BadInput(f"{str(folder)!r} is another print, with {told}; give its own jobs and speed")
    _same_rig(planned.rig, before)
    left_in(before, limits(planned.rig))


def left_by_a_host(planned: Plan, machines: Machines | VideoMachines, folder: str | Path) -> Interrupted:
    """What a host left in a folder, of the same print. Raises `BadInput`, `StorageError`."""
    may_go_on(planned, folder)
    return interrupted(folder, machines.controller, planned.schedule, limits(planned.rig))


def _same_rig(rig: RigConfig, run: Run) -> None:
    """Raise `BadInput` for a rig whose light or motion is another than the one that began a print."""
    file, given = run.path / "rig.toml", run.asked.get("settings", ())
    try:
        first = parse_rig(file.read_text(encoding="utf-8"), given, source=str(file))
    except OSError as error:
        raise explained("read", file, error) from error
    began, now = (_light(read.wanted) for read in (first, rig))
    if different := [name for name in now if now[name] != began[name]]:
        settings = "".join(f" --set {setting!r}" for setting in given)
        raise BadInput(
            f"the rig has other values in [{'], ['.join(different)}] than the one that began {str(run.path)!r}: the "
            f"rest would get another light; print with --rig {str(file)!r}{settings}"
        )


def _light(rig: RigFile) -> dict[str, Any]:
    """What of a rig's file must stay as it is before a print goes on."""
    told = rig.model_dump(exclude={"rig", "safety", "camera", "camera_stage", "photodiode"})
    for section in (told["controller"], *told["projector"], told["lens"], told["stage"]):
        for name in ("port", "library"):
            (section or {}).pop(name, None)
    return told


def run_folder(planned: Plan, folder: str | Path, left: Interrupted | None, now: int) -> RunFolder:
    """A new folder of a run, or that of one that is gone on with, up to what was shown. Raises `StorageError`.

    now: by the rig's clock [ns].
    """
    if left is None:
        return RunFolder.begin(folder, asked_for(planned), planned.rig.text)
    record = RunFolder.again(folder)
    left.take_up(record, planned.schedule, now)
    return record

"""`load`: read saved plans, frames, proofs and jobs."""

from __future__ import annotations

from pathlib import Path

from vamgpu.backend import open_device
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, StorageError
from vamgpu.jobs.read import Job, read_job
from vamgpu.jobs.web import WebJob, is_web, is_web_folder, read_web
from vamgpu.methods.plan import Plan
from vamgpu.methods.plan_folder import load_plan
from vamgpu.printing.folder import frames_of
from vamgpu.printing.frames import Frames
from vamgpu.printing.proof import Proof
from vamgpu.printing.proof_folder import load_proof
from vamgpu.storage.atomic import as_path
from vamgpu.storage.folder import Folder
from vamgpu.webs.store import WebFolder


def load(path: str | Path, device: str | Device | None = None) -> Plan | Frames | Proof | Job | WebFolder | WebJob:
    """Read what `Plan.save`, `Frames.save` or `Proof.save` wrote, a folder of ``vam solve``, or a job file.

    Args:
        path: A job folder, or a TOML job file.
        device: Device for the arrays; by default the best one.

    Returns:
        The saved `Plan`, `Frames` or `Proof`; for a folder of ``vam solve`` its `Frames`, whose ``plan`` has patterns,
        operator and target. A `WebFolder` for the folder of a web; a checked job for a file.

    Raises:
        StorageError: The folder is missing, of another kind, or damaged.
        JobError: A key of a job file is invalid.
        BadInput: The argument is not a path.
    """
    place = as_path(path)
    if place.suffix.lower() == ".toml":
        return read_web(place) if is_web(place) else read_job(place)
    if is_web_folder(place):
        return WebFolder.open(place)
    folder, there = Folder.open(place), open_device(device)
    saved = folder.manifest.details.get("saved", "frames")
    if saved == "plan":
        return load_plan(place, there)
    if saved == "proof":
        return load_proof(place, there)
    return frames_of(folder, there, _plan_of(folder, there))


def _plan_of(folder: Folder, device: Device) -> Plan | None:
    """The plan of a folder that stores patterns; None for bytes, or for an operator that only Python describes."""
    if "geometry" not in folder.manifest.inputs or folder.record("frames").dtype == "uint8":
        return None
    try:
        return load_plan(folder.path, device)
    except BadInput as error:
        raise StorageError(f"the plan of {str(folder.path)!r} cannot be restored: {error}; write it again") from error

"""The versions of a print's frames in its run folder: ``plans/0001/projector-1`` and so on, each complete before it may
be shown. A resumed print and the proof of a run read them there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from vamgpu.hosts.records.record import RunRecord
from vamgpu.printing.folder import load_frames, save_frames
from vamgpu.printing.frames import Frames
from vamgpu.storage.atomic import replacing

PLANS = "plans"


def kept_at(run: Path, number: int) -> Path:
    """Folder of a version in a run."""
    return run / PLANS / f"{number:04d}"


def keep(run: Path, number: int, frames: Sequence[Frames], facts: Mapping[str, Any]) -> None:
    """Store a version in a run's folder atomically. Raises `StorageError`."""
    with replacing(kept_at(run, number)) as draft:
        draft.mkdir()
        for engine, each in enumerate(frames, 1):
            save_frames(draft / f"projector-{engine}", each, inputs=dict(facts))


def kept_frames(run: Path, number: int, engine: int, device: Any = None) -> Frames:
    """The frames of a version for a projector. Raises `StorageError`."""
    return load_frames(kept_at(run, number) / f"projector-{engine + 1}", device)


def last_kept(run: Path) -> int:
    """The greatest number of a version in a run's folder; 0 for none."""
    place = run / PLANS
    return max((int(each.name) for each in place.iterdir() if each.name.isdigit()), default=0) if place.is_dir() else 0


def swaps(run: RunRecord) -> list[dict[str, Any]]:
    """The versions that a run committed, in order."""
    return [event for event in run.events if event["event"] == "swap"]

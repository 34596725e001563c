"""A small screw in a vial, for monitored prints."""

from __future__ import annotations

from pathlib import Path

from vamgpu.jobs.demo import _begun
from vamgpu.jobs.read import Job
from vamgpu.jobs.run import StageProgress, quiet, solve

JOB = """\
# A screw of 2.4 mm in a vial of 16 mm whose resin and wall are matched, small enough to be replanned in a second.
# Its thread has no mirror plane, so that a mirrored image would be seen.

[target]
shape = "screw"
height = "2.4 mm"
pitch = "150 um"

[beam]
pitch = "150 um"

[turntable]
angles = 60

[vial]
radius = "8 mm"
wall = "0.5 mm"
resin_index = 1.5
wall_index = 1.5
bath_index = 1.0
absorption = "0.1 1/mm"

[solve]
method = "lbfgs"
iterations = 30

[frames]
bits = 8
"""

AGED = {
    "inhibitor": 41.8 / 56.8, "lamp": 1.0, "drift": 0.003, "absorption": 0.1, "across": 0.3, "along_z": 0.02,
}  # fmt: skip
"""Differences between the demo's print and its plan (`vamgpu.live.Truth`): the third print of the paper, and more."""


def demo_job(out: str | Path, *, progress: StageProgress = quiet) -> Path:
    """Solve and write the job of the monitored demo. Raises `StorageError`."""
    job, left = _begun(Job, JOB, out, "screw", (), "report.html")
    solve(job, left.folder, overwrite=True, progress=progress)
    return left.folder

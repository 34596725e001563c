"""Plans that stop by themselves: which vials can, and what their rigs need for it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vamgpu.errors import BadInput, JobError, StorageError
from vamgpu.geometry import positive
from vamgpu.hosts.exposure import Stop
from vamgpu.hosts.rigs.planning import Plan
from vamgpu.printing.scatter import STOP
from vamgpu.storage.folder import Folder


def stopping(planned: Plan, threshold: float = STOP) -> Plan:
    """A plan that stops when the resin scatters enough; its turns are the most that it takes.

    threshold: [gray levels/voxel] of the camera and the voxels of the first job's part.  Raises `BadInput` for what is
    no vial, `JobError` for a rig without a camera, `StorageError` for a job that does not hold its part.
    """
    positive("threshold of scatter [gray levels/voxel]", threshold)
    if planned.kind != "vial":
        raise BadInput("only vials stop by their scatter, as all of the part gels at once; print without a stop")
    rig = planned.rig.wanted
    if rig.camera is None:
        raise JobError(
            f"the rig {rig.rig.name!r} has no table [camera], and a camera watches how much the resin scatters; add it "
            "to the rig's file, or print without a stop"
        )
    camera = rig.camera
    stop = Stop(float(threshold), _voxels(planned.works[0].path), camera.bits, camera.exposure, camera.discard)
    return replace(planned, stop=stop)


def _voxels(path: str) -> float:
    """Of a job's part: the sum of its fractions."""
    folder = Folder.open(path)
    if "target" not in folder.manifest.arrays:
        raise StorageError(
            f"{path!r} does not hold its part, whose voxels scatter is counted by; write it with `vam solve`, or print "
            "without a stop"
        )
    return float(folder.array("target").sum(dtype=np.float64))

"""The angles of a print in a manifest."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from vamgpu.errors import StorageError
from vamgpu.geometry import Turntable
from vamgpu.schema import write
from vamgpu.schema.read import read
from vamgpu.storage.reading import malformed


def described(motion: Turntable) -> dict[str, Any]:
    """Describe a turntable for a manifest."""
    found: dict[str, Any] = {"angles": motion.angles, "lit_share": motion.lit_share}
    if motion.theta is not None:
        found["theta"] = list(motion.theta)
    if motion.dwell is not None:
        found["dwell"] = list(motion.dwell)
    if motion.travel is not None:
        found["travel"] = write(motion.travel)
    return found


def turntable_from(description: Mapping[str, Any]) -> Turntable:
    """Make the turntable from its description; one without a lit share was written for a container at rest."""
    with malformed("the turntable in the manifest is malformed", "write the job again"):
        count, theta, dwell = description["angles"], description.get("theta"), description.get("dwell")
        path = description.get("travel")
        travel = None if path is None else read("travel", path, units=False)
        motion = Turntable(count if theta is None else theta, dwell, description.get("lit_share", 0.0), travel)
    if motion.angles != count:
        raise StorageError(f"the manifest has {count!r} angles, and {motion.angles} measured ones; write the job again")
    return motion

"""The angles of a print in a manifest."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from vamgpu.errors import BadInput, StorageError
from vamgpu.geometry import Turntable


def described(motion: Turntable) -> dict[str, Any]:
    """Describe a turntable for a manifest."""
    found: dict[str, Any] = {"angles": motion.angles, "lit_share": motion.lit_share}
    if motion.theta is not None:
        found["theta"] = list(motion.theta)
    if motion.dwell is not None:
        found["dwell"] = list(motion.dwell)
    return found


def turntable_from(description: Mapping[str, Any]) -> Turntable:
    """Make the turntable from its description; one without a lit share was written for a container at rest."""
    try:
        count, theta, dwell = description["angles"], description.get("theta"), description.get("dwell")
        motion = Turntable(count if theta is None else theta, dwell, description.get("lit_share", 0.0))
    except (KeyError, TypeError, AttributeError, BadInput) as error:
        raise StorageError(f"the turntable in the manifest is malformed: {error}; write the job again") from error
    if motion.angles != count:
        raise StorageError(f"the manifest has {count!r} angles, and {motion.angles} measured ones; write the job again")
    return motion

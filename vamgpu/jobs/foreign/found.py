"""What the files of another program hold."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from vamgpu.backend.device import Device
from vamgpu.geometry import Turntable
from vamgpu.jobs.model import JobFile
from vamgpu.targets.target import Target

Voxelize = Callable[[JobFile, Device], Target]


@dataclass(frozen=True, eq=False)
class Found:
    """Patterns of another program.

    Args:
        program: Whose they are.
        light: ≥ 0, [angle, r, z], in any unit.
        motion: The angles they are for; None where nobody says, which a job then does.
        tables: What the files say of the print, as tables of a job file.
        target: Makes the part where the files hold it; None where a job does.
        full: Light of a full-on pixel; None takes the brightest.
        notes: What a reader should know: what was left out or assumed.
    """

    program: str
    light: np.ndarray
    motion: Turntable | None = None
    tables: dict[str, Any] = field(default_factory=dict)
    target: Voxelize | None = None
    full: float | None = None
    notes: tuple[str, ...] = ()

"""Patterns read from the files of another program."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from vamgpu.backend.device import Device
from vamgpu.geometry import Turntable
from vamgpu.jobs.model import JobFile
from vamgpu.targets.target import Target

STEPPED = "its container is at rest while a pattern is shown (turntable.lit_share = 0)"
"""A note for programs that cannot turn while a pattern is shown."""

Voxelize = Callable[[JobFile, Device], Target]


@dataclass(frozen=True, eq=False)
class ForeignPatterns:
    """Patterns of another program; a job supplies the fields that are None."""

    program: str
    light: np.ndarray  # [angle, r, z] ≥ 0, in any unit
    motion: Turntable | None = None
    tables: dict[str, Any] = field(default_factory=dict)  # of a job file
    target: Voxelize | None = None
    full: float | None = None  # irradiance of a full-on pixel; None uses the brightest pixel
    notes: tuple[str, ...] = ()  # what was left out or assumed

"""A container that turns while a frame is lit: positions on the way, and means over them."""

from __future__ import annotations

from collections.abc import Callable
from math import ceil, sqrt

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.geometry import Turntable
from vamgpu.operators.compose import combine

CURVED = 0.03  # mean error [columns] of a voxel's position if its curved path is taken as straight
APART = 0.35  # greatest distance [voxels] between positions at which one ray per pixel is traced


def straight_parts(motion: Turntable, reach: float) -> int:
    """Number of parts of a frame's arc, each straight to within `CURVED`, for voxels out to ``reach`` [columns]."""
    return max(ceil(float(motion.arcs.max()) * sqrt(reach / (24.0 * CURVED))), 1)


def ray_parts(motion: Turntable, reach: float) -> int:
    """Number of parts of a frame's arc with one ray per pixel each, for voxels out to ``reach`` [voxels]."""
    return max(ceil(float(motion.arcs.max()) * reach / APART), 1)


def places(motion: Turntable, parts: int) -> list[np.ndarray]:
    """Angles [rad] in the middle of each part of every frame's arc, (angles,) for each part."""
    return [motion.poses + motion.arcs * ((part + 0.5) / parts - 0.5) for part in range(parts)]


def mean(parts: int, compute: Callable[[int, DeviceArray], None], out: DeviceArray) -> None:
    """out = mean over the parts of the result that ``compute`` writes for each part's number."""
    compute(0, out)
    if parts == 1:
        return
    another = out.device.empty(out.shape)
    for part in range(1, parts):
        compute(part, another)
        weight = 1.0 / parts if part == parts - 1 else 1.0
        combine(weight, out, weight, another, out)

"""Shared by several pictures: the boat, straight light for it, and the vial of the automatic exposure paper."""

from __future__ import annotations

from math import ceil

import numpy as np

from vamgpu.backend.device import Device
from vamgpu.geometry import Beam, Turntable
from vamgpu.operators.projection import Projection
from vamgpu.optics.vial import Vial
from vamgpu.targets.shapes import build
from vamgpu.targets.target import Target

VIAL = Vial(radius=12.4, wall=1.0, resin_index=1.49962, wall_index=1.473, bath_index=1.0, absorption=0.05)


def boat(device: Device, pitch: float, height: float = 11.5) -> Target:
    """The boat on voxels of ``pitch`` [mm]."""
    return Target.from_mesh(build("boat"), height=height, pitch=pitch, device=device)


def straight(target: Target, angles: int, device: Device) -> Projection:
    """A vat of the resin's index that absorbs almost nothing, one voxel per pixel."""
    nx, _, nz = target.grid.shape
    return Projection(target.grid, Beam((nx, nz), target.grid.pitch), Turntable(angles), device=device)


def in_vial(target: Target, angles: int, device: Device) -> Projection:
    """The vial in air, pixels that are one voxel wide in the resin; rows cover the part."""
    grid, pixel = target.grid, target.grid.pitch * VIAL.resin_index
    columns = 2 * ceil(grid.inscribed_radius * VIAL.resin_index / pixel) + 4
    rows = ceil(grid.shape[2] * grid.pitch / pixel) + 1
    return Projection(grid, Beam((columns, rows), pixel), Turntable(angles), VIAL, device)


def upright(volume: np.ndarray) -> np.ndarray:
    """The plane y = 0 of a volume, [x, z]."""
    return volume[:, volume.shape[1] // 2]


def level(volume: np.ndarray, share: float) -> np.ndarray:
    """The plane at a share of the height, [x, y]."""
    return volume[:, :, min(int(share * volume.shape[2]), volume.shape[2] - 1)]

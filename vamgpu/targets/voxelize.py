"""From a closed surface to the fraction of every voxel that it fills, computed on a device."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from vamgpu.backend import open_device
from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.errors import OutOfMemory, TargetTooLarge
from vamgpu.geometry import Grid
from vamgpu.kernels.voxelize import FINEST
from vamgpu.kernels.voxelize import voxelize as scan
from vamgpu.targets.solid import Solid

Integers = npt.NDArray[np.int64]

_BITS = 10
"""Fine units per voxel edge, as a power of two, where the solid is small enough."""
_REACH = 20
"""Largest extent in fine units, as a power of two: volumes of three extents then fit 63 bits."""
_TIE = 1e-6
"""Added before rounding to the fine grid, so that round lengths never sit on a tie that rounding errors decide."""


class Voxels(NamedTuple):
    """fraction: field [x, y, z] on the device, 0..1.  volume: sum of the fractions [mm³]."""

    fraction: DeviceArray
    volume: float


def voxelize(solid: Solid, grid: Grid, device: str | Device | None = None) -> Voxels:
    """The part of each voxel of ``grid`` inside ``solid``, in the solid's own place, on ``device``.

    Corners are rounded to 1/1024 of a voxel (coarser beyond 1024 voxels); the fraction is exact along z at 16 points of
    each (x, y) column. All devices give the same numbers. It is the winding number clipped to 0..1: overlapping bodies
    count once, bodies wound inward are cavities. What lies outside the grid is cut off.

    Raises TargetTooLarge where the solid or grid is more than 32768 voxels wide, OutOfMemory, DeviceError.
    """
    place = open_device(device)
    corners, bits = snapped(solid, grid)
    triangles = oriented(corners, solid.faces)
    tile = _tile(place)
    fraction = _allocate(place, grid)
    members, first, last = binned(triangles, grid, bits, tile)
    filled = place.empty(first.shape, place.kept("float32"), table=True)
    place.launch(
        scan,
        triangles=place.table(triangles, "int32"),
        members=place.table(members, "int32"),
        first=place.table(first, "int32"),
        last=place.table(last, "int32"),
        tile=tile,
        bits=bits,
        volume=fraction,
        filled=filled,
    )
    return Voxels(fraction, float(filled.numpy().sum(dtype=np.float64)) * grid.voxel_volume)


def snapped(solid: Solid, grid: Grid) -> tuple[Integers, int]:
    """Vertices on the fine grid, int64 (n, 3), counted from the grid's low corner; bits: log2 of units per voxel."""
    voxels = solid.vertices / grid.pitch + 0.5 * np.asarray(grid.shape)
    low, high = np.minimum(voxels.min(axis=0), 0.0), np.maximum(voxels.max(axis=0), grid.shape)
    widest = float(np.max(high - low))
    bits = min(_BITS, _REACH - int(np.ceil(np.log2(widest))))
    if bits < FINEST:
        raise TargetTooLarge(
            f"{solid.name} on {grid.shape} voxels of {grid.pitch:g} mm is {widest:.0f} voxels wide; "
            f"wanted at most {1 << (_REACH - FINEST)}: use a larger pitch"
        )
    return np.floor(voxels * (1 << bits) + (0.5 + _TIE)).astype(np.int64), bits


def oriented(corners: Integers, faces: npt.NDArray[np.int32]) -> npt.NDArray[np.int32]:
    """Triangles counter-clockwise from above with a sign, int32 (m, 10); those seen edge-on are left out."""
    triangles = corners[faces]
    (ax, ay), (bx, by), (cx, cy) = triangles[:, :, :2].transpose(1, 2, 0)
    area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    rows = np.empty((len(faces), 10), np.int32)
    rows[:, :3] = triangles[:, 0]
    up = (area > 0)[:, None]
    rows[:, 3:6] = np.where(up, triangles[:, 1], triangles[:, 2])
    rows[:, 6:9] = np.where(up, triangles[:, 2], triangles[:, 1])
    rows[:, 9] = np.sign(area)
    return rows[area != 0]


def binned(
    triangles: npt.NDArray[np.int32], grid: Grid, bits: int, tile: int
) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int32], npt.NDArray[np.int32]]:
    """Triangles by square of tile × tile columns: members[first[i, j]:last[i, j]] may cross the square (i, j)."""
    tiles = np.array([-(-n // tile) for n in grid.shape[:2]])
    box = triangles[:, :9].reshape(-1, 3, 3)[:, :, :2]
    low = np.maximum((box.min(axis=1) >> bits) // tile, 0)
    high = np.minimum((box.max(axis=1) >> bits) // tile, tiles - 1)
    size = np.maximum(high - low + 1, 0)
    count = size[:, 0] * size[:, 1]
    which = np.repeat(np.arange(len(triangles), dtype=np.int32), count)
    place = np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)
    across = np.maximum(size[which, 1], 1)
    home = (low[which, 0] + place // across) * tiles[1] + low[which, 1] + place % across
    total = int(tiles.prod())
    if total <= 1 << 16:
        home = home.astype(np.uint16)  # NumPy sorts short keys much faster
    order = np.argsort(home, kind="stable")
    last = np.cumsum(np.bincount(home, minlength=total))
    first = np.concatenate([[0], last[:-1]])
    return which[order], first.reshape(tiles).astype(np.int32), last.reshape(tiles).astype(np.int32)


def _tile(device: Device) -> int:
    """Columns along the side of an item's square: GPUs want many items, CPUs few lists."""
    return 2 if getattr(device, "is_gpu", "cuda" in device.name) else 8


def _allocate(device: Device, grid: Grid) -> DeviceArray:
    size = 4.0 * float(np.prod(grid.shape, dtype=np.float64)) / 1e9
    try:
        return device.empty(grid.shape)
    except (OutOfMemory, MemoryError, ValueError) as error:
        raise OutOfMemory(
            f"a target of {grid.shape} voxels takes {size:.1f} GB, and {device.name} has no room for it ({error}); "
            "use a larger pitch"
        ) from error

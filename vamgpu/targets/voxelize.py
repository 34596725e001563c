"""Fraction of every voxel that a closed surface fills, computed on a device."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from vamgpu.backend import open_device
from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.errors import OutOfMemory, TargetTooLarge
from vamgpu.geometry import Grid
from vamgpu.kernels.voxelize import FINEST, count_crossings
from vamgpu.kernels.voxelize import voxelize as scan
from vamgpu.targets.solid import Solid

Integers = npt.NDArray[np.int64]

_BITS = 10  # fine units per voxel edge, as a power of two, if the solid is small enough
_REACH = 20  # largest extent in fine units, as a power of two: products of three extents then fit 63 bits
_ROOM = 1 << 26  # crossings in memory at a time, 256 MB; a part with more is processed in bands
_TIE = 1e-6
"""Added before rounding to the fine grid; round lengths then never lie on a tie that rounding errors would decide."""


class Voxels(NamedTuple):
    """fraction: field [x, y, z] on the device, 0..1.  volume: sum of the fractions [mm³]."""

    fraction: DeviceArray
    volume: float


def voxelize(solid: Solid, grid: Grid, device: str | Device | None = None) -> Voxels:
    """The share of each voxel of ``grid`` inside ``solid``, which keeps its place, on ``device``."""
    # corners on 1/1024 of a voxel; exact along z at 16 points of a column; inside where the winding number is ≥ 1
    place = open_device(device)
    corners, bits = snapped(solid, grid)
    triangles = oriented(corners, solid.faces, grid.shape[2] << bits)
    tile = 2 if place.is_gpu else 8  # columns along a work item's square: GPUs prefer many items, CPUs few lists
    fraction = _allocate(place, grid)
    members, first, last = binned(triangles, grid, bits, tile)
    shared = {"triangles": place.table(triangles, "int32"), "members": place.table(members, "int32")}
    counts = place.empty(grid.shape[:2], "int32", table=True)
    whole = {"first": place.table(first, "int32"), "last": place.table(last, "int32")}
    place.launch(count_crossings, **shared, **whole, tile=tile, bits=bits, counts=counts)
    bands, start, longest = listed(counts.numpy(), tile, _ROOM)
    lists, starts = place.empty((longest,), "int32", table=True), place.table(start, "int32")
    filled = 0.0
    for band in bands:
        sums = place.empty(first[band].shape, place.kept("float32"), table=True)
        place.launch(
            scan,
            **shared,
            first=place.table(first[band], "int32"),
            last=place.table(last[band], "int32"),
            start=starts,
            tile=tile,
            bits=bits,
            row=band.start,
            lists=lists,
            volume=fraction,
            filled=sums,
        )
        filled += float(sums.numpy().sum(dtype=np.float64))
    return Voxels(fraction, filled * grid.voxel_volume)


def listed(counts: npt.NDArray[np.integer], tile: int, room: int) -> tuple[list[slice], npt.NDArray[np.int32], int]:
    """Layout of the crossing lists of all columns in shared memory."""
    entries = counts.astype(np.int64).sum(axis=1) + counts.shape[1]
    rows = np.add.reduceat(entries, np.arange(0, len(entries), tile))
    cuts, held = [0], 0
    for row, size in enumerate(rows.tolist()):
        if held and held + size > room:
            cuts.append(row)
            held = 0
        held += size
    cuts.append(len(rows))
    bands = [slice(low, high) for low, high in pairwise(cuts)]
    longest = max(int(rows[band].sum()) for band in bands)
    if longest >= 1 << 31:
        raise TargetTooLarge(
            f"rays of {tile} rows of columns cross the surface {longest} times; expected at most {1 << 31}: use a "
            "larger pitch or a mesh with fewer bodies"
        )
    start = np.empty(counts.shape, np.int32)
    for band in bands:
        of_band = counts[band.start * tile : band.stop * tile]
        after = np.cumsum(of_band.ravel() + 1, dtype=np.int64)
        start[band.start * tile : band.stop * tile] = (after - of_band.ravel() - 1).reshape(of_band.shape)
    return bands, start, longest


def snapped(solid: Solid, grid: Grid) -> tuple[Integers, int]:
    """Vertices on the fine grid, int64 (n, 3), counted from the grid's low corner. bits: log2 of units per voxel."""
    voxels = solid.vertices / grid.pitch + 0.5 * np.asarray(grid.shape)
    low, high = np.minimum(voxels.min(axis=0), 0.0), np.maximum(voxels.max(axis=0), grid.shape)
    widest = float(np.max(high - low))
    bits = min(_BITS, _REACH - int(np.ceil(np.log2(widest))))
    if bits < FINEST:
        raise TargetTooLarge(
            f"{solid.name} on {grid.shape} voxels of {grid.pitch:g} mm is {widest:.0f} voxels wide; "
            f"expected at most {1 << (_REACH - FINEST)}: use a larger pitch"
        )
    return np.floor(voxels * (1 << bits) + (0.5 + _TIE)).astype(np.int64), bits


def oriented(corners: Integers, faces: npt.NDArray[np.int32], top: int | None = None) -> npt.NDArray[np.int32]:
    """Triangles counter-clockwise from above, with a sign, int32 (m, 10); triangles seen edge-on are left out."""
    x, y, z = np.ascontiguousarray(corners.T)
    a, b, c = np.ascontiguousarray(faces.T)
    area = (x[b] - x[a]) * (y[c] - y[a]) - (y[b] - y[a]) * (x[c] - x[a])
    kept = area != 0
    if top is not None:
        kept &= np.minimum(np.minimum(z[a], z[b]), z[c]) < top
    kept = np.flatnonzero(kept)
    a, b, c, area = a[kept], b[kept], c[kept], area[kept]
    rows = np.empty((len(kept), 10), np.int32)
    placed = corners.astype(np.int32)
    rows[:, :3] = placed[a]
    rows[:, 3:6] = placed[np.where(area > 0, b, c)]
    rows[:, 6:9] = placed[np.where(area > 0, c, b)]
    rows[:, 9] = np.sign(area)
    return rows


def binned(
    triangles: npt.NDArray[np.int32], grid: Grid, bits: int, tile: int
) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int32], npt.NDArray[np.int32]]:
    """Triangles by square of tile × tile columns: members[first[i, j]:last[i, j]] may cross the square (i, j)."""
    tiles = np.array([-(-n // tile) for n in grid.shape[:2]])
    a, b, c = (triangles[:, k : k + 2] for k in (0, 3, 6))
    low = np.maximum((np.minimum(np.minimum(a, b), c) >> bits) // tile, 0)
    high = np.minimum((np.maximum(np.maximum(a, b), c) >> bits) // tile, tiles - 1)
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


def _allocate(device: Device, grid: Grid) -> DeviceArray:
    size = 4.0 * float(np.prod(grid.shape, dtype=np.float64)) / 1e9
    try:
        return device.empty(grid.shape)
    except (OutOfMemory, MemoryError, ValueError) as error:
        raise OutOfMemory(
            f"a target of {grid.shape} voxels takes {size:.1f} GB, and {device.name} has no room for it ({error}); "
            "use a larger pitch"
        ) from error

"""The table of a projection on rings, made on the device from the light of one pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.geometry import Beam
from vamgpu.kernels.ring_table import ring_coefficients, ring_entries
from vamgpu.kernels.spectrum import ROWS
from vamgpu.operators.polar import PolarGrid, PoseTile
from vamgpu.operators.ring_splines import NEXT, OWN, pivots, tracks
from vamgpu.operators.transforms import Passes, ring_band, ring_radices

MANY = 1 << 20  # columns that fill whole slabs of every device


@dataclass(frozen=True)
class RingTable:
    """Entries, tiles and their light, as in `vamgpu.kernels.spectrum`; no entry exceeds ``greatest``."""

    entries: DeviceArray
    greatest: float
    tiles: np.ndarray
    lit: np.ndarray
    mirrored: bool


def ring_table(grid: PolarGrid, beam: Beam, given: Sequence[PoseTile], device: Device, faint: float = 0.0,
               splines: bool = False) -> RingTable:  # fmt: skip
    """The products of each angular frequency, from the light of one pose in every `ROWS` rings."""
    # faint: entries of a tile's outermost columns up to this share of the greatest entry count as 0.  splines:
    # whether entries give coefficients of `ring_splines`, not doses.
    columns, mirrored = beam.pixels[0], all(each.is_mirrored(beam.pixels[0]) for each in given)
    half = columns // 2 if mirrored else 0
    all_pairs = _in_rows(columns - half)
    last = [each.last(beam) for each in given]
    if splines:  # coefficients extend into the next tile, falling to a third per ring
        last = [*last[1:], 2 * last[-1] - last[-2] if last[1:] else all_pairs + half]
    wide = [min(_in_rows(each + 1 - half), all_pairs) for each in last]
    tiles, own, size = _tiles(grid, wide)
    device = getattr(device, "members", (device,))[0]  # no slices are shared
    entries = device.reserve(((grid.angles // 2 + 1) * size,))
    strip = min(device.lanes_for(MANY) or all_pairs, all_pairs)
    bands = {n: [ring_band(grid.angles, n, ROWS, 0, n * ROWS)] for n in {band.samples for band in grid.bands}}
    passes = {n: Passes(device, own, ring_radices(device, grid.angles, [n])) for n, own in bands.items()}
    for tile, width, numbers in zip(given, wide, own, strict=True):
        begins = np.array([tiles[number][0] for number in numbers])
        shape = (grid.angles, len(numbers) * ROWS)
        fields = [device.empty((*shape, strip)) for _ in range(3)]
        write, arcs = tile.pose(beam, shape, device), device.table(tile.arcs)
        for first in range(0, width, strip):
            halved = first == 0 and mirrored and columns % 2  # a column in the middle is a pair with itself
            write(half + first, 0.5 if halved else 1.0, fields[0])
            device.launch(
                ring_entries,
                spectrum=passes[len(numbers)].run(-1.0, fields[0], fields[1:].__getitem__),
                begins=device.table(begins + 2 * ROWS * first, "int32"),
                arcs=arcs,
                columns=width - first,
                entries=entries,
            )
    peaks = _peaks(grid, np.array(tiles)[:, :2], entries, splines, all_pairs // ROWS)
    most = float(peaks.max(initial=0.0))
    if most == 0.0:
        raise BadInput("no column of the beam lights a ring; widen the beam, or check the vessel's radius, absorption "
                       "and scattering: too much of either lets no light through")  # fmt: skip
    lit = ROWS * np.where(peaks > faint * most, np.arange(1, peaks.shape[2] + 1), 0).max(axis=2, initial=0)
    return RingTable(entries, most, np.array(tiles)[:, [0, 2]], lit, mirrored)


def _peaks(grid: PolarGrid, tiles: np.ndarray, entries: DeviceArray, splines: bool, blocks: int) -> np.ndarray:
    """The greatest entry of each frequency, tile and `ROWS` pairs, after samples became coefficients of splines."""
    device, steps = entries.device, tracks(grid)
    if not splines:
        steps[:, 3:5] = -1  # no tile leads to another
    peaks = device.empty((grid.angles // 2 + 1, len(tiles), blocks), table=True)
    device.launch(
        ring_coefficients,
        steps=device.table(np.column_stack([tiles, steps]), "int32"),
        pivots=device.table(pivots(grid.rings) if splines else np.ones((grid.rings, 2))),
        angles=grid.angles,
        own=OWN if splines else 1.0,
        beside=NEXT if splines else 0.0,
        entries=entries,
        peaks=peaks,
    )
    return peaks.numpy()


def _tiles(grid: PolarGrid, wide: list[int]) -> tuple[list[tuple[int, int, int]], list[list[int]], int]:
    """Where each tile begins, its pairs and its mate; the tiles of each footprint, with ``wide`` pairs; and the end."""
    tiles, own = list[tuple[int, int, int]](), [list[int]() for _ in wide]
    start = number = 0
    for band in grid.bands:
        for j in range(band.samples):
            for ring in range(len(band.tiles)):
                own[number + ring].append(len(tiles))
                mate = (band.cell + (band.samples - 1 - j) * band.rings) // ROWS + ring
                tiles.append((start, wide[number + ring], mate))
                start += 2 * ROWS * wide[number + ring]
        number += len(band.tiles)
    return tiles, own, start


def _in_rows(count: int) -> int:
    """The least multiple of `ROWS` that is at least this number."""
    return -(-max(count, 0) // ROWS) * ROWS

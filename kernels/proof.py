"""The dose of frames in the resin, computed independently of the solver's operators."""

from __future__ import annotations

from collections.abc import Iterator
from math import ceil
from typing import Annotated

import numpy as np

from vamgpu.kernels.footprint import look_up, middle
from vamgpu.kernels.signature import Field, Integer, Real, SinogramOut, Table, Tiling, VolumeOut, kernel

Light = Annotated[np.ndarray, Field(("angle", "r", "row"))]
Rows = Annotated[np.ndarray, Field(("angle", "r", "z"))]
Profile = Annotated[np.ndarray, Field(("angle", "bin", "z"))]
ProfileOut = Annotated[np.ndarray, Field(("angle", "bin", "z"), writes=True)]
Fine = Annotated[np.ndarray, Field(("u", "v", "level"))]

RowShares = Annotated[np.ndarray, Table("float32", ("row", "slice"))]
"""Light of each slice from the light of a row; slices beyond the last z fill whole vectors."""
RowSpan = Annotated[np.ndarray, Table("int32", ("slice", "2"))]
"""First row that lights a slice, and the one after the last; its shares beyond them are 0. Both never fall."""
First = Annotated[np.ndarray, Table("int32", ("bin",))]
ColumnShares = Annotated[np.ndarray, Table("float32", ("bin", "tap"))]
"""Light of each bin from the light of column first + tap."""
Poses = Annotated[np.ndarray, Table("float32", ("arc", "4"))]
"""Cosine, sine, time over the mean time, half the turn meanwhile [rad]; equally many successive arcs for each angle."""
Pose = Annotated[np.ndarray, Table("float32", ("branch", "across", "along", "4"))]
"""First and last bin (with fractions) whose light crosses a voxel, its share, and a spare."""
Taps = Annotated[np.ndarray, Table("float32", ("2", "tap"))]


@kernel(over="spread", cpu=Tiling(major=1, minor=0), gpu=Tiling(major=1, minor=1, group=(128, 1)))
def spread_rows(light: Light, shares: RowShares, span: RowSpan, lanes: Integer, spread: SinogramOut) -> None:
    """spread[angle, r, z] = Σ over rows of shares[row, z] × light[angle, r, row]; lanes: of the light's layout."""
    spread[...] = light @ shares[:, : spread.shape[2]]


@kernel(over="profile", cpu=Tiling(major=1, minor=0), gpu=Tiling(major=1, minor=1, group=(128, 1)))
def spread_columns(spread: Rows, first: First, shares: ColumnShares, profile: ProfileOut) -> None:
    """profile[angle, bin, z] = Σ over taps of shares[bin, tap] × spread[angle, first[bin] + tap, z]."""
    profile[...] = 0.0
    for tap in range(shares.shape[1]):
        profile += shares[None, :, tap, None] * spread[:, first + tap]


@kernel(
    over="dose",
    cpu=Tiling(major=8, minor=0, slabs=16),
    gpu=Tiling(major=1, minor=1, slabs=4, group=(64, 4)),
    constants={"cpu": {"TURNS": 4, "BINS": 8}},
)
def expose_voxels(
    profile: Profile, poses: Poses, pose: Pose, scale: Real, single: Real, radius: Real, dose: VolumeOut
) -> None:
    """dose[x, y, z] = Σ over arcs and branches of time × share × the mean light between two moving bins."""
    # pose: of the fixed frame, samples ``1 / scale`` voxels apart about the axis. single: voxels this close to the axis
    # are only on the first branch. Voxels beyond ``radius`` voxels from the axis get nothing.
    dose[...] = 0.0
    for angle, lit, bins, weights in spans(poses, pose, scale, single, radius, profile.shape, dose.shape[:2]):
        dose[lit] += sum(weight[:, None] * profile[angle, bin] for weight, bin in zip(weights.T, bins.T, strict=True))


def spans(
    poses: np.ndarray, pose: np.ndarray, scale: float, single: float, radius: float, profile: tuple[int, ...],
    shape: tuple[int, ...],
) -> Iterator[tuple[int, tuple[np.ndarray, ...], np.ndarray, np.ndarray]]:  # fmt: skip
    """Angle, lit voxels [x, y], bins [voxel, bin] and weights of every arc and branch; shape: along x and y."""
    x, y = np.meshgrid(*(np.arange(n) - middle(n) for n in shape), indexing="ij")
    far = x**2 + y**2
    reached = [np.nonzero((far <= radius**2) & ((branch == 0) | (far > single**2))) for branch in range(len(pose))]
    for arc, (c, s, time, half) in enumerate(poses):
        for table, lit in zip(pose, reached, strict=True):
            across, along = (y[lit] * c - x[lit] * s) * scale, -(x[lit] * c + y[lit] * s) * scale
            ways = (-half, half) if half > 0 else (0.0,)
            ends = np.stack([look_up(table, across + h * along, along - h * across) for h in ways])
            crossed = (ends[..., 1] > ends[..., 0]).any(axis=0)
            lit, ends = tuple(place[crossed] for place in lit), ends[:, crossed, :3]
            low, high, share = np.moveaxis(ends, -1, 0)
            first = np.floor(low.min(axis=0, initial=profile[1] + 0.5) - 0.5)
            bins = first[:, None] + np.arange(ceil((high.max(axis=0, initial=0.0) - first).max(initial=0.0)) + 1)
            around = np.concatenate([bins[:, :1] - 1, bins, bins[:, -1:] + 1], axis=1) + 0.5
            weights = np.diff(_beyond(high, around) - _beyond(low, around), n=2, axis=1)
            weights = np.where((bins >= 0) & (bins < profile[1]), weights, 0.0)
            bins = np.clip(bins, 0, profile[1] - 1).astype(int)
            yield arc * profile[0] // len(poses), lit, bins, time * share.mean(axis=0)[:, None] * weights


def _beyond(place: np.ndarray, edge: np.ndarray) -> np.ndarray:
    """Mean of t²/2 while a position [2, voxel] moves uniformly from first to second; t: beyond an edge, or 0."""
    low, high = (end(place, axis=0)[:, None] - edge for end in (np.min, np.max))
    crossing = np.maximum(high, 0.0) ** 3 / (6.0 * np.where(high > low, high - low, 1.0))
    return np.where(low >= 0, (low * low + low * high + high * high) / 6.0, crossing)


@kernel(over="volume", cpu=Tiling(major=1, minor=0), gpu=Tiling(major=1, minor=1, group=(64, 4)))
def average_voxels(
    fine: Fine, taps: Taps, finer: Integer, corner_x: Integer, corner_y: Integer, first: Integer, volume: VolumeOut
) -> None:
    """volume[x, y, first + level] = Σ taps[0, a] taps[1, b] fine[corner_x + f x + a, corner_y + f y + b, level]."""
    # f: ``finer``. Other slices do not change. Values beyond ``fine`` count as 0. ``first`` and the number of levels
    # are multiples of the layout's lanes, which are those of the volume, unless the levels are all slices.
    u, v, levels = fine.shape
    nx, ny, nz = volume.shape
    count = min(levels, nz - first)
    volume[:, :, first : first + count] = 0.0
    for a, b in np.ndindex(taps.shape[1], taps.shape[1]):
        i, j = corner_x + finer * np.arange(nx) + a, corner_y + finer * np.arange(ny) + b
        x, y = np.flatnonzero((i >= 0) & (i < u)), np.flatnonzero((j >= 0) & (j < v))
        if x.size and y.size:
            part = taps[0, a] * taps[1, b] * fine[np.ix_(i[x], j[y], np.arange(count))]
            volume[np.ix_(x, y, first + np.arange(count))] += part

"""What frames do to the resin, computed apart from the operators that solve.

A pixel's light is spread once along z and once along r into fine bins. Rays traced through one pose say between which
bins the light lies that crosses a voxel; where caustics fold the light they say so for every fold, a branch. Fine
voxels then take what lies between, and part voxels the mean of fine ones.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated

import numpy as np

from vamgpu.kernels.project import middle
from vamgpu.kernels.signature import Field, Integer, Real, SinogramOut, Table, Tiling, VolumeOut, kernel

Light = Annotated[np.ndarray, Field(("angle", "r", "row"))]
Rows = Annotated[np.ndarray, Field(("angle", "r", "z"))]
Profile = Annotated[np.ndarray, Field(("angle", "bin", "z"))]
ProfileOut = Annotated[np.ndarray, Field(("angle", "bin", "z"), writes=True)]
Fine = Annotated[np.ndarray, Field(("u", "v", "level"))]

RowShares = Annotated[np.ndarray, Table("float32", ("row", "slice"))]
"""Light of each slice per light of a row; slices beyond the last z fill whole vectors."""
RowSpan = Annotated[np.ndarray, Table("int32", ("slice", "2"))]
"""First row and the row behind the last that light a slice, beyond which its shares are 0; neither ever falls."""
First = Annotated[np.ndarray, Table("int32", ("bin",))]
ColumnShares = Annotated[np.ndarray, Table("float32", ("bin", "tap"))]
"""Light of each bin per light of column first + tap."""
Poses = Annotated[np.ndarray, Table("float32", ("angle", "4"))]
"""Cosine, sine, time over the mean time, and a spare."""
Pose = Annotated[np.ndarray, Table("float32", ("branch", "across", "along", "4"))]
"""First and last bin (with fractions) whose light crosses a voxel, its share, and a spare."""
Taps = Annotated[np.ndarray, Table("float32", ("tap",))]


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
    cpu=Tiling(major=16, minor=0, slabs=4),
    gpu=Tiling(major=1, minor=1, slabs=4, group=(64, 4)),
    constants={"cpu": {"ANGLES": 12, "TOGETHER": 16, "CAPACITY": 64}},
)
def expose_voxels(
    profile: Profile, poses: Poses, pose: Pose, scale: Real, single: Real, radius: Real, dose: VolumeOut
) -> None:
    """dose[x, y, z] = Σ over poses and branches of time × share × the light between two bins of the profile.

    pose: of the laboratory, samples ``1 / scale`` voxels apart about the axis.  single: voxels this near to the axis
    are on the first branch alone.  Voxels beyond ``radius`` voxels from the axis get nothing.
    """
    dose[...] = 0.0
    total = np.concatenate([np.zeros_like(profile[:, :1]), np.cumsum(profile, axis=1)], axis=1)
    for angle, lit, low, high, weight in spans(poses, pose, scale, single, radius, dose.shape[:2]):
        dose[lit] += weight[:, None] * (_running(total[angle], high) - _running(total[angle], low))


def spans(
    poses: np.ndarray, pose: np.ndarray, scale: float, single: float, radius: float, shape: tuple[int, ...]
) -> Iterator[tuple[int, np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """For every pose and branch: its number, the voxels [x, y] lit, between which bins their light lies, their share.

    Arguments as for `expose_voxels`; shape: voxels along x and y.
    """
    x, y = (np.arange(n) - middle(n) for n in shape)
    far = x[:, None] ** 2 + y[None, :] ** 2
    for angle, (c, s, time, _) in enumerate(poses):
        across = (y[None, :] * c - x[:, None] * s) * scale
        along = -(x[:, None] * c + y[None, :] * s) * scale
        for branch, table in enumerate(pose):
            low, high, share = np.moveaxis(_look_up(table, across, along)[..., :3], -1, 0)
            lit = (high > low) & (far <= radius**2) & ((branch == 0) | (far > single**2))
            yield angle, lit, low[lit], high[lit], time * share[lit]


def _look_up(table: np.ndarray, across: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Linear interpolation of a table [across, along, :] about its middle."""
    across, along = across + middle(table.shape[0]), along + middle(table.shape[1])
    i = np.clip(across.astype(int), 0, table.shape[0] - 2)
    j = np.clip(along.astype(int), 0, table.shape[1] - 2)
    a, b = (across - i)[..., None], (along - j)[..., None]
    near = (1 - b) * table[i, j] + b * table[i, j + 1]
    return (1 - a) * near + a * ((1 - b) * table[i + 1, j] + b * table[i + 1, j + 1])


def _running(total: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Running integral [place, z] at fractional bins, constant beyond both ends."""
    k, part = whole_and_part(len(total), place)
    return (1 - part)[:, None] * total[k] + part[:, None] * total[k + 1]


def whole_and_part(count: int, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sample before each place, of so many, and what is left; constant beyond both ends."""
    place = np.clip(place, 0.0, count - 1.0)
    k = np.minimum(place.astype(int), count - 2)
    return k, place - k


@kernel(over="volume", cpu=Tiling(major=1, minor=0), gpu=Tiling(major=1, minor=1, group=(64, 4)))
def average_voxels(
    fine: Fine, taps: Taps, corner_x: Integer, corner_y: Integer, first: Integer, volume: VolumeOut
) -> None:
    """volume[x, y, first + level] = Σ taps[a] taps[b] fine[corner_x + 2 x + a, corner_y + 2 y + b, level].

    Other slices stay as they are. What lies beyond ``fine`` counts as 0. ``first`` and the number of levels are
    multiples of the layout's lanes, which are those of the volume, unless the levels are all there are.
    """
    u, v, levels = fine.shape
    nx, ny, nz = volume.shape
    count = min(levels, nz - first)
    volume[:, :, first : first + count] = 0.0
    for a, b in np.ndindex(taps.size, taps.size):
        i, j = corner_x + 2 * np.arange(nx) + a, corner_y + 2 * np.arange(ny) + b
        x, y = np.flatnonzero((i >= 0) & (i < u)), np.flatnonzero((j >= 0) & (j < v))
        if x.size and y.size:
            part = taps[a] * taps[b] * fine[np.ix_(i[x], j[y], np.arange(count))]
            volume[np.ix_(x, y, first + np.arange(count))] += part

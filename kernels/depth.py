"""Signed depth of voxels' centers below the surface of a part, from the voxels' fractions, and doses by depth."""

from __future__ import annotations

from itertools import product
from typing import Annotated

import numpy as np

from vamgpu.kernels.signature import Array, Field, Integer, Real, Table, Tiling, VolumeOut, kernel

HALF = 0.5
"""Fraction from which a voxel is in the part."""
FARTHEST = 13
"""Greatest number of voxels along an axis to the nearest cut voxel."""
SIDE = 2 * FARTHEST + 1
FULL = 1e-4
"""Fractions closer than this to 0 or 1 count as empty or full."""
PATCH = 0.6
"""Radius [voxels] of the piece of plane that represents the surface in one voxel."""
THIN = 1e-4
"""Lower limit of the components of a normal in the formula for the fraction of a cube."""
STEPS = 7
"""Number of Newton's steps for a plane's position in its voxel."""
NO_CUT = 1e9
"""Place and packed steps where there is no cut voxel; greater than all others."""
NO_DEPTH = -1e12
"""Depths below this are not counted."""

Fractions = Annotated[np.ndarray, Field(("x", "y", "z"))]
Part = Annotated[np.ndarray, Field(("x", "y", "source"))]
DepthOut = Annotated[np.ndarray, Field(("x", "y", "z"), writes=True)]
Ends = Annotated[np.ndarray, Table("int32", ("i", "2"))]
"""First of a row's voxels that count, and the one after the last."""
BinsOut = Annotated[np.ndarray, Table("float32", ("part", "bin"), writes=True)]
CountsOut = Annotated[np.ndarray, Table("uint32", ("part", "bin"), writes=True)]
ROWS = 4
"""Rows of voxels that a GPU's work item sorts."""


@kernel(over="place", reach="all", cpu=Tiling(major=1, minor=0))
def cut_voxels(fraction: Fractions, place: VolumeOut, steps: VolumeOut) -> None:
    """place = depth of a voxel's center behind the plane that cuts it, steps = 0 packed; `NO_CUT` if none does."""
    # Both sides of a face between a full and an empty voxel are cut.
    cut = (fraction > FULL) & (fraction < 1.0 - FULL)
    for axis in range(3):
        jump = np.moveaxis(np.abs(np.diff(fraction, axis=axis)) > 1.0 - 2.0 * FULL, axis, 0)
        sides = np.moveaxis(cut, axis, 0)
        sides[:-1] |= jump
        sides[1:] |= jump
    place[...], steps[...] = NO_CUT, np.where(cut, _packed(0, 0, 0), NO_CUT)
    place[cut] = _place(np.abs(_normals(fraction, np.nonzero(cut))), fraction[cut])


def _packed(x: int, y: int, z: int) -> int:
    near = (x + FARTHEST) + SIDE * (y + FARTHEST) + SIDE**2 * (z + FARTHEST)
    return SIDE**3 * (x * x + y * y + z * z) + near


def _normals(fraction: np.ndarray, at: tuple[np.ndarray, ...]) -> np.ndarray:
    """Inward normals (n, 3) of the surface in voxels; the outermost voxels repeat beyond the ends."""
    gradient, last = np.zeros((at[0].size, 3)), np.array(fraction.shape) - 1
    for offset in product((-1, 0, 1), repeat=3):
        index = np.clip(np.stack(at, axis=1) + offset, 0, last)
        weight = 4.0 / 2 ** sum(map(abs, offset))  # 2, 1 and 1/2: faces, edges and corners
        gradient += weight * fraction[tuple(index.T)][:, None] * offset
    length = np.linalg.norm(gradient, axis=1, keepdims=True)
    flat = length[:, 0] < 1e-6  # a sheet within one row of voxels: any direction is equally good
    gradient[flat], length[flat] = (0.0, 0.0, 1.0), 1.0
    return gradient / length


def _place(normal: np.ndarray, filled: np.ndarray) -> np.ndarray:
    """Depths of the centers of unit cubes behind the planes that leave ``filled`` of them; (n,)."""
    sides = np.maximum(normal, THIN)
    half = 0.5 * sides.sum(axis=1)
    # Up to half a cube, the filled share is a convex function of the cut: Newton's steps from there converge.
    less, cut = np.minimum(filled, 1.0 - filled), half.copy()
    for _ in range(STEPS):
        share, area = _corner(sides, cut)
        cut = np.maximum(cut - (share - less) / np.maximum(area, 1e-9), 0.0)
    return np.where(filled < 0.5, cut - half, half - cut)


def _corner(sides: np.ndarray, cut: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Share of the unit cube with sides · y <= cut, and its derivative by the cut; sides (n, 3), all > 0."""
    a, b, c = sides.T
    share, slope = np.zeros_like(cut), np.zeros_like(cut)
    for corner, sign in ((0.0, 1), (a, -1), (b, -1), (c, -1), (a + b, 1), (a + c, 1), (b + c, 1), (a + b + c, -1)):
        beyond = np.maximum(cut - corner, 0.0)
        slope += sign * beyond**2
        share += sign * beyond**3
    volume = 6.0 * a * b * c
    return share / volume, 3.0 * slope / volume


@kernel(over="nearest", reach="all", cpu=Tiling(major=1, minor=0))
def nearest_cut(steps: Fractions, axis: Integer, span: Integer, nearest: VolumeOut) -> None:
    """nearest = least of the packed steps of voxels up to ``span`` away along an axis, each after a step there."""
    given, found = np.moveaxis(steps, axis, 0), np.moveaxis(nearest, axis, 0)
    found[...] = given
    for k in range(1, min(int(span), len(given) - 1) + 1):
        for step, to, of in ((k, slice(k, None), slice(-k)), (-k, slice(-k), slice(k, None))):
            found[to] = np.minimum(found[to], given[of] + (SIDE**3 * k * k + SIDE ** int(axis) * step))


@kernel(over="depth", reach="all", cpu=Tiling(major=1, minor=0))
def signed_depths(
    fraction: Part, place: Part, steps: Part, first: Integer, lanes: Integer, reach: Real, pitch: Real, depth: DepthOut
) -> None:  # fmt: skip
    """depth[x, y, z] = pitch · distance of slice first + z from the nearest piece of surface, > 0 in the part."""
    # Distances end at ``reach`` [voxels]. lanes: of the fields' layout (0 if they are plain).
    some = slice(int(first), int(first) + depth.shape[2])
    packed, inside = steps[:, :, some], fraction[:, :, some] >= HALF
    found = np.full(packed.shape, float(reach))
    near = np.nonzero(packed < SIDE**3 * int((reach + 1.0) ** 2 + 1.0))  # no nearer surface lies beyond
    number = packed[near].astype(np.int64)
    step = np.stack([number // SIDE**axis % SIDE - FARTHEST for axis in range(3)])
    own = tuple(np.stack(near) + [[0], [0], [int(first)]] - step)
    across = (step.T * _normals(fraction, own)).sum(axis=1)
    beside = np.sqrt(np.maximum((step**2).sum(axis=0) - across**2, 0.0))
    found[near] = np.minimum(np.hypot(across + place[own], np.maximum(beside - PATCH, 0.0)), reach)
    depth[...] = pitch * np.where(inside, found, -found)


@kernel(over="dose", cpu=Tiling(major=16, minor=0), gpu=Tiling(major=ROWS, minor=0, group=(8, 8)))
def tally_depths(
    dose: Array, depth: Array, ends: Ends, width: Real, rounding: Real, least: BinsOut, greatest: BinsOut,
    counts: CountsOut,
) -> None:  # fmt: skip
    """Least dose and number of voxels in the part, and greatest dose outside, by steps of ``width`` of the distance."""
    # The last bin of the three tables holds +∞, the greatest dose of all (NaN if one is not finite, −∞ without any) and
    # 0; the one before it, all depths from the last step on. rounding: added to distances, in steps.
    column, last = np.arange(dose.shape[1]), least.shape[1] - 2
    counted = (ends[:, :1] <= column) & (column < ends[:, 1:])
    counted = counted[..., None] & (depth > NO_DEPTH)
    least[...], greatest[...], counts[...] = np.inf, -np.inf, 0
    steps = np.minimum(np.abs(depth) / width + rounding, last).astype(np.int64)
    inside, outside = counted & (depth >= 0.0), counted & (depth < 0.0)
    np.minimum.at(least[0], steps[inside], dose[inside])
    np.maximum.at(greatest[0], steps[outside], dose[outside])
    counts[0] = np.bincount(steps[inside], minlength=last + 2)
    most = dose[counted].max(initial=-np.inf)
    greatest[0, -1] = np.nan if np.isposinf(most) else most

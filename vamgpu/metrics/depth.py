"""Signed depth of voxels' centers below the surface of a part, computed only from the fractions of the voxels.

The fraction of a partly filled voxel tells where the surface cuts it: at the plane, perpendicular to the local
gradient, that fills this share of a cube (as in volume-of-fluid codes: D. L. Youngs, Numerical Methods for Fluid
Dynamics (1982) 273). Every other voxel finds the nearest of these small planes by an exact Euclidean feature transform,
one axis after another, up to a given distance.
"""

from __future__ import annotations

from itertools import product
from math import ceil

import numpy as np
import numpy.typing as npt

from vamgpu.backend.cores import ahead
from vamgpu.errors import BadInput
from vamgpu.geometry import positive

Array = npt.NDArray[np.float32]
Floats = npt.NDArray[np.float64]

HALF = 0.5
"""Fraction from which a voxel is in the part."""
LARGEST_REACH = 14
"""Number of voxels that a search may span: the steps along an axis are packed in five bits."""
_FULL = 1e-4
"""Fractions closer than this to 0 or 1 count as empty or full."""
_PATCH = 0.6
"""Radius [voxels] of the piece of plane that represents the surface in one voxel."""
_THIN = 1e-4
"""Lower limit of the components of a normal in the formula for the fraction of a cube."""
_STEPS = 7
"""Number of Newton's steps for a plane's position in its voxel."""
_PLANES = 32
"""Number of planes along x that a thread processes."""
_BITS = 5
_NONE = np.uint32(1 << 30)
"""A number above every packed number, with space for the additions of the passes."""


def surrounded(fraction: Array, by: int, flat: bool = False) -> Array:
    """Fractions with a border of this many voxels: copies of the ends above and below a flat part, else empty."""
    beside = np.pad(fraction, ((by, by), (by, by), (0, 0)))
    return np.pad(beside, ((0, 0), (0, 0), (by, by)), mode="edge" if flat else "constant")


def padded_depth(fraction: Array, reach: float, flat: bool) -> tuple[Array, int]:
    """Depths [voxels] that are right up to ``reach``, with the border of voxels that this needs; and its width."""
    pad = ceil(reach) + 2
    return signed_depth(surrounded(fraction, pad, flat), reach + 0.5), pad


def signed_depth(fraction: npt.ArrayLike, reach: float) -> Array:
    """Distance of every voxel's center from the surface of a part, positive in the part."""
    # fraction [x, y, z], unknown beyond the array: pad it with zeros, and give a slab reach + 2 more voxels on either
    # side; reach [voxels], at most 12; returns [voxels] [x, y, z]
    values = np.asarray(fraction, np.float32)
    if values.ndim != 3 or not values.size:
        raise BadInput(f"the fractions have shape {values.shape}; expected [x, y, z] with at least one voxel")
    span = ceil(positive("reach [voxels]", reach)) + 1
    if span > LARGEST_REACH - 1:
        raise BadInput(f"reach is {reach:g} voxels; expected at most {LARGEST_REACH - 2}: judge finer voxels in steps")
    depth = np.full(values.shape, -reach, np.float32)
    box = _box(values, span)
    if box is None:
        return depth
    padded, inner, halo = np.pad(values[box], ((1, 1), (1, 1), (1, 1)), mode="edge"), depth[box], span + 1

    def planes(first: int) -> Array:
        begin = max(first - halo, 0)
        near = _near(padded[begin : first + _PLANES + halo + 2], span, float(reach))
        return near[first - begin : first - begin + _PLANES]

    firsts = range(0, inner.shape[0], _PLANES)
    for first, near in zip(firsts, ahead(planes, firsts), strict=True):
        inner[first : first + _PLANES] = near
    return depth


def _box(values: Array, span: int) -> tuple[slice, slice, slice] | None:
    """The part's bounding box, ``span`` voxels wider; None without a part."""
    filled = values > _FULL
    if not filled.any():
        return None
    plane = np.any(filled, axis=2)
    x, y, z = (
        slice(max(int(at[0]) - span, 0), int(at[-1]) + 1 + span)
        for at in (
            np.flatnonzero(np.any(side, axis=axis)) for side, axis in ((plane, -1), (plane, 0), (filled, (0, 1)))
        )
    )
    return x, y, z


def _near(padded: Array, span: int, reach: float) -> Array:
    """Signed distances of a block that is padded by one voxel."""
    core = padded[1:-1, 1:-1, 1:-1]
    inside = core >= HALF
    depth = np.where(inside, np.float32(reach), np.float32(-reach))
    seeds = np.flatnonzero(_cut(padded))
    if not seeds.size:
        return depth
    normal, place = _planes(padded, np.unravel_index(seeds, core.shape))
    keys = _nearest(core.shape, seeds, span).ravel()
    band = np.flatnonzero(keys < int((reach + 1.0) ** 2 + 1) << 3 * _BITS)
    number = np.zeros(core.size, np.int32)
    number[seeds] = np.arange(seeds.size, dtype=np.int32)
    x, y, z = _steps(keys[band], span)
    back = (x * core.shape[1] + y).astype(np.int64) * core.shape[2] + z.astype(np.int64)
    own = number[band - back]
    across = x * normal[own, 0] + y * normal[own, 1] + z * normal[own, 2]
    beside = np.sqrt(np.maximum(x * x + y * y + z * z - across * across, 0.0))
    distance = np.hypot(across + place[own], np.maximum(beside - _PATCH, 0.0))
    near = np.minimum(distance, np.float32(reach))
    depth.ravel()[band] = np.where(inside.ravel()[band], near, -near)
    return depth


# ---- the surface in each voxel --------------------------------------------------------------------------------------
def _cut(padded: Array) -> npt.NDArray[np.bool_]:
    """Voxels that contain the surface, including both sides of a face between full and empty."""
    core = padded[1:-1, 1:-1, 1:-1]
    cut = (core > _FULL) & (core < 1.0 - _FULL)
    for axis in range(3):
        for side in (0, 2):
            at = tuple(slice(side, padded.shape[k] - 2 + side) if k == axis else slice(1, -1) for k in range(3))
            cut |= np.abs(core - padded[at]) > 1.0 - 2.0 * _FULL
    return cut


def _planes(padded: Array, at: tuple[npt.NDArray[np.intp], ...]) -> tuple[Array, Array]:
    """Inward normals (n, 3) of the surface in voxels, and depths [voxels] of their centers behind it (n,)."""
    gradient = np.zeros((at[0].size, 3), np.float32)
    for offset in product((-1, 0, 1), repeat=3):
        if offset == (0, 0, 0):
            continue
        x, y, z = (index + 1 + d for index, d in zip(at, offset, strict=True))
        value = padded[x, y, z]
        weight = 4.0 / 2 ** sum(map(abs, offset))  # 2, 1 and 1/2: faces, edges and corners
        for axis, d in enumerate(offset):
            if d:
                gradient[:, axis] += np.float32(d * weight) * value
    length = np.linalg.norm(gradient, axis=1, keepdims=True)
    flat = length[:, 0] < 1e-6  # a sheet within one row of voxels: any direction is equally good
    gradient[flat], length[flat] = (0.0, 0.0, 1.0), 1.0
    normal = gradient / length
    filled = padded[at[0] + 1, at[1] + 1, at[2] + 1]
    return normal, _place(np.abs(normal).astype(np.float64), filled.astype(np.float64)).astype(np.float32)


def _place(normal: Floats, filled: Floats) -> Floats:
    """Depths of the centers of unit cubes behind the planes that leave ``filled`` of them; (n,)."""
    sides = np.maximum(normal, _THIN)
    half = 0.5 * sides.sum(axis=1)
    # Up to half a cube, the filled share is a convex function of the cut: Newton's steps from there converge.
    less, cut = np.minimum(filled, 1.0 - filled), half.copy()
    for _ in range(_STEPS):
        share, area = _corner(sides, cut)
        cut -= (share - less) / np.maximum(area, 1e-9)
        np.maximum(cut, 0.0, out=cut)
    return np.where(filled < 0.5, cut - half, half - cut)


def _corner(sides: Floats, cut: Floats) -> tuple[Floats, Floats]:
    """Share of the unit cube with sides · y <= cut, and its derivative by the cut; sides (n, 3), all > 0."""
    a, b, c = sides.T
    share, slope = np.zeros_like(cut), np.zeros_like(cut)
    for corner, sign in ((0.0, 1), (a, -1), (b, -1), (c, -1), (a + b, 1), (a + c, 1), (b + c, 1), (a + b + c, -1)):
        beyond = np.maximum(cut - corner, 0.0)
        square = beyond * beyond
        slope += sign * square
        share += sign * square * beyond
    volume = 6.0 * a * b * c
    return share / volume, 3.0 * slope / volume


# ---- the nearest seed -----------------------------------------------------------------------------------------------
def _nearest(shape: tuple[int, ...], seeds: npt.NDArray[np.intp], span: int) -> npt.NDArray[np.uint32]:
    """Squared distances of voxels to the nearest seed and the steps from it, packed; from `_NONE` on without seed."""
    # Exact for seeds at most ``span`` voxels away along every axis: the smallest packed number has the smallest
    # distance, whatever steps its lower bits hold.
    keys = np.full(shape, _NONE, np.uint32)
    keys.ravel()[seeds] = sum(span << (_BITS * axis) for axis in range(3))
    for axis in range(3):
        old, n = keys, shape[axis]
        keys = old.copy()
        for k in range(1, min(span, n - 1) + 1):
            for step in (k, -k):
                to = tuple(slice(max(step, 0), n + min(step, 0)) if a == axis else slice(None) for a in range(3))
                of = tuple(slice(max(-step, 0), n + min(-step, 0)) if a == axis else slice(None) for a in range(3))
                more = (k * k << 3 * _BITS) + (step << _BITS * axis)
                np.minimum(keys[to], old[of] + np.uint32(more), out=keys[to])
    return keys


def _steps(keys: npt.NDArray[np.uint32], span: int) -> tuple[Array, Array, Array]:
    """Steps [voxels] from the seed to the voxel along x, y and z, (n,) each."""
    x, y, z = ((keys >> _BITS * axis & 31).astype(np.float32) - np.float32(span) for axis in range(3))
    return x, y, z

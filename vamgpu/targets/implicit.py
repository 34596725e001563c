"""Solids given by a function of space, φ < 0 inside, and the fraction of every voxel that they fill."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from vamgpu.errors import BadInput
from vamgpu.geometry import Grid, counts
from vamgpu.web import WebGrid

Array = npt.NDArray[np.float64]

SAMPLES = 4  # cube root of the default number of sample points in a voxel that the surface may cross
PLASTIC = 1.2207440846057596  # the root of x⁴ = x + 1: its powers spread points in three dimensions
_POINTS = 1 << 19  # number of points whose function values are in memory at a time


@runtime_checkable
class Implicit(Protocol):
    """A solid as a function of space: φ(x, y, z) < 0 inside, > 0 outside, all in mm.

    The arguments are arrays that broadcast together, as the result: x, y, z in a vial, l, ρ, z on a web.
    A shape may also have a method ``bound(x, y, z)``: it has the same sign, and its magnitude is at most the distance
    to the surface [mm]. Voxels that it proves to be full or empty are not sampled.
    """

    def __call__(self, x: Array, y: Array, z: Array, /) -> Array: ...


@runtime_checkable
class Bounded(Protocol):
    """A shape with a lower bound on the distance to its surface."""

    def bound(self, x: Array, y: Array, z: Array, /) -> Array:
        """At most the distance to the surface; negative inside."""
        ...


class Distance(Bounded, Protocol):
    """A shape whose function never exceeds the distance to its surface."""

    def __call__(self, x: Array, y: Array, z: Array, /) -> Array:
        """Distance [mm], negative inside."""
        ...

    def bound(self, x: Array, y: Array, z: Array, /) -> Array:
        return self(x, y, z)


def voxelize(
    shape: Implicit, grid: Grid | WebGrid, *, start: float = 0.0, samples: int = SAMPLES
) -> npt.NDArray[np.float32]:
    """Filled fraction of every voxel, float32 [x, y, z] or [l, rho, z]: the share of ``samples``³ points inside."""
    if not callable(shape):
        raise BadInput(f"got a {type(shape).__name__} as shape; expected a function φ(x, y, z), negative in the solid")
    samples = counts("samples", (samples,), 1)[0]
    (x, y, z), edges = grid.axes(), grid.edges if isinstance(grid, WebGrid) else (grid.pitch, grid.pitch, grid.pitch)
    fraction = np.empty(grid.shape, np.float32)
    rows = max(1, _POINTS // (grid.shape[1] * grid.shape[2]))
    for first in range(0, len(x), rows):
        part = slice(first, first + rows)
        fraction[part] = _filled(shape, x[part] + start, y, z, edges, samples)
    return fraction


def _filled(
    shape: Implicit, x: Array, y: Array, z: Array, edges: tuple[float, float, float], samples: int
) -> npt.NDArray[np.float32]:
    """Fractions of a slab of voxels with these centers."""
    size = (len(x), len(y), len(z))
    if isinstance(shape, Bounded):
        near = asked(shape.bound, x[:, None, None], y[None, :, None], z[None, None, :], size)
        fraction = (near < 0).astype(np.float32)
        crossed = np.nonzero(np.abs(near) <= 0.5 * float(np.hypot.reduce(edges)) * (1.0 + 1e-9))
    else:
        fraction = np.zeros(size, np.float32)
        crossed = np.nonzero(np.ones(size, bool))
    offsets = _offsets(edges, samples)
    count = max(1, _POINTS // len(offsets))
    for first in range(0, len(crossed[0]), count):
        index = tuple(axis[first : first + count] for axis in crossed)
        a, b, c = (axis[i][:, None] + step for axis, i, step in zip((x, y, z), index, offsets.T, strict=True))
        inside = asked(shape, a, b, c, a.shape) < 0
        fraction[index] = inside.mean(axis=1)
    return fraction


def _offsets(edges: tuple[float, float, float], samples: int) -> Array:
    """Points (``samples``³, 3) of a voxel about its center, in pairs that are symmetric about it."""
    # no two points share a coordinate; faces parallel to the voxels are therefore resolved as well as others
    pairs, center = divmod(samples**3, 2)
    step = 1.0 / PLASTIC ** np.arange(1, 4)
    some = ((np.arange(pairs)[:, None] + 0.5) * step) % 1.0 - 0.5
    return np.concatenate([some, -some, np.zeros((center, 3))]) * edges


def asked(shape: Callable[[Array, Array, Array], Array], x: Array, y: Array, z: Array, size: tuple[int, ...]) -> Array:
    """The function at points that broadcast to ``size``; `BadInput` if the result is not such an array of numbers."""
    value = np.asarray(shape(x, y, z))
    if value.shape != size:
        raise BadInput(
            f"the shape's function gave an array of {value.shape} for points of {size}; expected the same shape: "
            "write it with NumPy functions of x, y and z"
        )
    if value.dtype.kind not in "fiub" or np.isnan(value).any():
        bad = "values that are no real numbers" if value.dtype.kind not in "fiub" else f"{np.isnan(value).sum()} NaN"
        raise BadInput(f"the shape's function gave {bad} at {size} points; expected φ < 0 in the solid, > 0 outside")
    return value

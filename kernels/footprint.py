"""Forward and back projection with exact footprints: an entry is the light of a pixel averaged over a voxel's box."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np

from vamgpu.kernels.signature import Integer, Real, Sinogram, SinogramOut, Table, Tiling, Volume, VolumeOut, kernel

Directions = Annotated[np.ndarray, Table("float32", ("angle", "3"))]
"""cosθ, sinθ, and the arc [rad] of the turn during which the angle is lit."""
Map = Annotated[np.ndarray, Table("float32", ("across", "along", "4"))]
"""Column of the light, its strength, and the columns per voxel across and along it, samples one voxel apart."""
Edges = Annotated[np.ndarray, Table("float32", ("r", "8"))]
"""p, cos d, sin d, slack of the two chords between which a column's light falls."""


def middle(n: int) -> float:
    """Index of the center of ``n`` samples."""
    return 0.5 * (n - 1)


def look_up(table: np.ndarray, across: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Linear interpolation of a table [across, along, :] about its middle, continued beyond its edge."""
    across, along = across + middle(table.shape[0]), along + middle(table.shape[1])
    i = np.clip(across.astype(int), 0, table.shape[0] - 2)
    j = np.clip(along.astype(int), 0, table.shape[1] - 2)
    a, b = (across - i)[..., None], (along - j)[..., None]
    near, far = ((1 - b) * table[i + k, j] + b * table[i + k, j + 1] for k in (0, 1))
    return (1 - a) * near + a * far


TAIL, FAR = 2.75, 4.0
"""Least distance in σ, beyond the boxes and from the middle, at which light (about 1e-4 of a pixel's) is cut off."""
FADE = 0.25
"""Range in σ over which a share fades out; rounding then does not decide whether it counts."""
SHARP = 1e-3
"""Range in columns over which a share without blur fades out, where it is 0 anyway."""
THINNEST, BLURRED = 0.05, 0.2
"""Columns + share of sigma: least width of a trapezoid's side; sums over corners cancel in float32 if it is thin.
Shares are then off by 2e-5 of the greatest; widening costs 2e-3 of it with a point spread, 2e-2 at an edge without."""
GPU = {"SAMPLES": 128, "KEPT": 1024, "TURNS": 16}
"""Numbers of samples for which a tile, and a group, keeps shares at a time; most angles or planes that they span."""
TAIL_SERIES = (9.973836443e-02, 2.202380776e-02, 3.491863407e-03, 2.423642034e-04, 7.122526186e-05)
"""Third integral of the unit Gaussian's tail: 0.25 / (1 + Σ c_k t^k)^16, fitted to the closed form to 3.1e-7."""


def third_integral(x: np.ndarray, sigma: float) -> np.ndarray:
    """Third integral from −∞ of a Gaussian of standard deviation ``sigma`` about 0; x₊²/2 for none."""
    if sigma == 0.0:
        return 0.5 * np.maximum(x, 0.0) ** 2
    tail = sigma**2 * 0.25 / np.polynomial.polynomial.polyval(np.abs(x) / sigma, (1.0, *TAIL_SERIES)) ** 16
    return np.where(x > 0.0, 0.5 * (x * x + sigma**2) - tail, tail)


def sides(a: np.ndarray, b: np.ndarray, sigma: float) -> tuple[np.ndarray, np.ndarray]:
    """Widths of a trapezoid's two boxes, neither below `THINNEST` + `BLURRED` σ, the sum of their squares kept."""
    least = THINNEST + BLURRED * sigma
    square, thin = a * a + b * b, np.maximum(np.minimum(a, b), least)
    return np.sqrt(np.maximum(square - thin**2, least**2)), thin


def exposed(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two boxes in place of three: the widest, and one with the variance of the others; a and b if c is 0."""
    wide, thin = np.maximum(a, b), np.minimum(a, b)
    widest = np.maximum(wide, c)
    other = np.hypot(thin, np.minimum(wide, c))
    return np.where(c > 0.0, widest, a), np.where(c > 0.0, other, b)


def share(distance: np.ndarray, a: np.ndarray, b: np.ndarray, fill: float, sigma: float) -> np.ndarray:
    """Mean over a voxel of the light of a pixel ``distance`` columns off; sums to 1 over pixels."""
    # In columns; a, b: widths of the trapezoid's boxes, fill: of a pixel's lit box, sigma: of the point spread.
    a, b = sides(a, b, sigma)
    total = np.zeros(np.broadcast(distance, a).shape)
    for x, sign in ((distance + 0.5 * fill, 1.0), (distance - 0.5 * fill, -1.0)):
        outer = third_integral(x + 0.5 * (a + b), sigma) + third_integral(x - 0.5 * (a + b), sigma)
        inner = third_integral(x + 0.5 * (a - b), sigma) + third_integral(x - 0.5 * (a - b), sigma)
        total += sign * (outer - inner)
    faded = np.clip((half_support(a, b, fill, sigma) - np.abs(distance)) / (FADE * sigma + SHARP), 0.0, 1.0)
    return faded * np.maximum(total, 0.0) / (a * b * fill)


def half_support(a: np.ndarray, b: np.ndarray, fill: float, sigma: float) -> np.ndarray:
    """Columns from a voxel's middle to the farthest pixel that lights it."""
    return np.maximum(0.5 * (a + b + fill) + TAIL * sigma, FAR * sigma)


def _matrix(
    shape: tuple[int, ...], columns: int, direction: np.ndarray, light: np.ndarray, bent: int, ratio: float,
    strength: float, fill: float, sigma: float, radius: float,
) -> Any:  # fmt: skip
    """Shares of columns in the voxels of a plane at one angle, sparse (columns, nx · ny)."""
    from scipy.sparse import csr_array

    x, y = (np.arange(n) - middle(n) for n in shape[:2])
    c, s, arc = direction
    x, y = x[:, None], y[None, :]
    lateral, depth = y * c - x * s, -(x * c + y * s)
    if bent:
        u, weight, g, h = np.moveaxis(look_up(light, lateral, depth), -1, 0)
    else:
        u = lateral * ratio + middle(columns)
        weight, g, h = np.full(u.shape, strength), np.full(u.shape, ratio), np.zeros(u.shape)
    weight = weight * (x**2 + y**2 <= radius**2)
    a, b = exposed(np.abs(g * s + h * c), np.abs(g * c - h * s), np.abs(g * depth - h * lateral) * arc)
    reach = half_support(*sides(a, b, sigma), fill, sigma)
    first = np.ceil(u - reach).astype(int)
    column = first + np.arange(int(np.floor(2.0 * reach.max())) + 1)[:, None, None]
    shares = weight * share(u - column, a, b, fill, sigma)
    kept = (column >= 0) & (column < columns) & (shares != 0.0)
    voxels = np.broadcast_to(np.arange(u.size).reshape(u.shape), kept.shape)
    return csr_array((shares[kept], (column[kept], voxels[kept])), shape=(columns, u.size))


@kernel(
    over="sinogram",
    cpu=Tiling(major=20, minor=0, slabs=4),
    gpu=Tiling(major=1, minor=4, slabs=4, group=(8, 8, 4)),
    constants={"cpu": {"ANGLES": 6, "TAPS": 16}, "gpu": GPU},
)
def forward_footprint(
    volume: Volume, directions: Directions, light: Map, edges: Edges, bent: Integer, ratio: Real, strength: Real,
    fill: Real, sigma: Real, radius: Real, taps: Integer, cells: Integer, sinogram: SinogramOut,
) -> None:  # fmt: skip
    """The transpose of `back_footprint`: every voxel adds to the columns that light it."""
    # A GPU gathers along the ray, between the edges; cells: most cells of a plane for four neighboring columns.
    columns, slices = sinogram.shape[1:]
    for angle, direction in enumerate(directions):
        pose = _matrix(volume.shape, columns, direction, light, bent, ratio, strength, fill, sigma, radius)
        sinogram[angle] = pose @ volume.reshape(-1, slices)


@kernel(
    over="volume",
    cpu=Tiling(major=16, minor=0, slabs=4),
    gpu=Tiling(major=2, minor=2, slabs=4, group=(16, 4, 4), registers=128),
    constants={"cpu": {"ANGLES": 6, "TAPS": 16}, "gpu": GPU},
)
def back_footprint(
    sinogram: Sinogram, directions: Directions, light: Map, bent: Integer, ratio: Real, strength: Real, fill: Real,
    sigma: Real, radius: Real, taps: Integer, volume: VolumeOut,
) -> None:  # fmt: skip
    """volume[x, y, z] = Σ over angles and columns of the column's light, averaged over the voxel, × the sinogram."""
    # bent: 0 for straight light, ``ratio`` columns per voxel, ``strength`` everywhere; 1 for light from the table
    # ``light``, at most ``ratio`` columns per voxel. fill, sigma: of a pixel and its point spread [columns]. Voxels
    # beyond ``radius`` voxels from the axis get nothing. taps: most columns that light a voxel.
    volume[...] = 0.0
    for angle, direction in enumerate(directions):
        pose = _matrix(volume.shape, sinogram.shape[1], direction, light, bent, ratio, strength, fill, sigma, radius)
        volume += (pose.T @ sinogram[angle]).reshape(volume.shape)

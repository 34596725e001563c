"""Light of one angle through a cylinder of resin whose absorbing species is depleted."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from vamgpu.kernels.signature import Field, Integer, Sinogram, Table, Tiling, Volume, VolumeOut, kernel
from vamgpu.kernels.transport import Open

Path = Annotated[np.ndarray, Field(("r", "s", "z"))]
PathOut = Annotated[np.ndarray, Field(("r", "s", "z"), writes=True)]
Pose = Annotated[np.ndarray, Table("float32", ("8",))]  # cosθ, sinθ, pitches along x, y, r and s, radius [mm], unused
Extinction = Annotated[np.ndarray, Table("float32", ("2", "2"))]  # color: μ [1/mm], ε [1/mm per concentration]


@kernel(over="path", cpu=Tiling(major=1, minor=0), gpu=Tiling(major=1, minor=0, group=(8, 8)))
def column_density(species: Volume, open: Open, pose: Pose, path: PathOut) -> None:
    """path[r, s, z] = ∫ of the species along the ray from where it enters the cylinder to s = s·step − radius."""
    # In the middle of a step, the species is interpolated between the open columns of voxels around it.
    cosine, sine, dx, dy, dr, step, radius, _ = (float(v) for v in pose)
    n_x, n_y, _ = species.shape
    path[...] = 0.0
    r = (np.arange(path.shape[0]) - 0.5 * (path.shape[0] - 1)) * dr
    half = np.sqrt(np.maximum(0.0, radius**2 - r**2))
    for k in range(1, path.shape[1]):
        begin, end = np.clip(step * (k - 1) - radius, -half, half), np.clip(step * k - radius, -half, half)
        s = 0.5 * (begin + end)
        i = (-r * sine - s * cosine) / dx + 0.5 * (n_x - 1)
        j = (r * cosine - s * sine) / dy + 0.5 * (n_y - 1)
        i0, j0 = np.floor(i).astype(int), np.floor(j).astype(int)
        total, weights = np.zeros((len(r), species.shape[2])), np.zeros(len(r))
        for a, b in ((0, 0), (0, 1), (1, 0), (1, 1)):
            ia, jb = np.clip(i0 + a, 0, n_x - 1), np.clip(j0 + b, 0, n_y - 1)
            weight = np.abs(1 - a - (i - i0)) * np.abs(1 - b - (j - j0)) * open[ia, jb]
            total += weight[:, None] * species[ia, jb]
            weights += weight
        path[:, k] = path[:, k - 1] + ((end - begin) / np.maximum(weights, 1e-6))[:, None] * total


@kernel(over="visible", cpu=Tiling(major=4, minor=0), gpu=Tiling(major=1, minor=1, group=(64, 4)))
def expose(
    path: Path, visible_light: Sinogram, ultraviolet_light: Sinogram, angle: Integer, pose: Pose,
    extinction: Extinction, visible: VolumeOut, ultraviolet: VolumeOut,
) -> None:  # fmt: skip
    """Irradiance of both colors in every voxel at one angle: light · exp(−μ·length − ε·path), dark beyond the resin."""
    # Light is interpolated between columns of pixels, path between rays and along them.
    cosine, sine, dx, dy, dr, step, radius, _ = (float(v) for v in pose)
    rays, steps, _ = path.shape
    x = ((np.arange(visible.shape[0]) - 0.5 * (visible.shape[0] - 1)) * dx)[:, None]
    y = ((np.arange(visible.shape[1]) - 0.5 * (visible.shape[1] - 1)) * dy)[None, :]
    r, s = y * cosine - x * sine, -(x * cosine + y * sine)
    length = np.maximum(0.0, s + np.sqrt(np.maximum(0.0, radius**2 - r**2)))
    u, w = r / dr + 0.5 * (rays - 1), np.clip((s + radius) / step, 0.0, steps - 1)
    lit = (x * x + y * y <= radius**2) & (u >= 0) & (u <= rays - 1)
    i, k = np.clip(u.astype(int), 0, max(rays - 2, 0)), np.clip(w.astype(int), 0, max(steps - 2, 0))
    i1, k1 = np.minimum(i + 1, rays - 1), np.minimum(k + 1, steps - 1)
    u, w = (u - i)[..., None], (w - k)[..., None]
    dense = (1 - u) * ((1 - w) * path[i, k] + w * path[i, k1]) + u * ((1 - w) * path[i1, k] + w * path[i1, k1])
    for light, (mu, epsilon), out in (
        (visible_light, extinction[0], visible),
        (ultraviolet_light, extinction[1], ultraviolet),
    ):
        shown = (1 - u) * light[angle, i] + u * light[angle, i1]
        out[...] = np.where(lit[..., None], shown * np.exp(-mu * length[..., None] - epsilon * dense), 0.0)

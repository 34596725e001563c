"""Where a column's power goes in the vial of the README, against rays traced one by one."""

from __future__ import annotations

import numpy as np
import pytest
from raytracer import ray_to, trace

import vamgpu as vam

VIAL = vam.Vial(12.4, 1.0, 1.49962, 1.473, 1.0, 0.05)
PITCH, VOXEL = 0.067, 0.09
GRID = vam.Grid((186, 186, 2), VOXEL)
POSES = 7
"""So few that no two of them are alike on a square grid."""
RAYS, STEP = 16, 0.01
"""Rays a column, and the way [mm] between the points at which a ray is looked at."""


def inside(radius: float) -> np.ndarray:
    """Voxels that lie in a disc with all four corners, (nx, ny)."""
    x, y, _ = GRID.axes()
    return np.hypot(np.abs(x)[:, None] + 0.5 * VOXEL, np.abs(y)[None, :] + 0.5 * VOXEL) < radius


def shares(motion: vam.Turntable, columns: int, disc: np.ndarray) -> np.ndarray:
    """Share of a column's power that is absorbed in those voxels, (angles, columns), by the midpoint rule."""
    half, n = 0.5 * columns * PITCH, columns * RAYS
    u = (np.arange(n) + 0.5) * (2.0 * half / n) - half
    found = []
    for pose in motion.poses:
        rays = trace(VIAL, np.full(n, pose), u)
        steps = int(np.ceil(rays.length.max() / STEP))
        s = (np.arange(steps) + 0.5) * (rays.length[:, None] / steps)
        x, y = np.moveaxis(rays.start[:, None, :] + s[..., None] * rays.heading[:, None, :], -1, 0)
        i, j = (np.floor(place / VOXEL + 0.5 * GRID.shape[0]).astype(int) for place in (x, y))
        kept = (i >= 0) & (i < GRID.shape[0]) & (j >= 0) & (j < GRID.shape[1])
        kept[kept] = disc[i[kept], j[kept]]
        absorbed = kept * VIAL.absorption * np.exp(-VIAL.absorption * s) * (rays.length[:, None] / steps)
        found.append((rays.power * absorbed.sum(axis=1)).reshape(columns, RAYS).mean(axis=1))
    return np.array(found)


def projection(columns: int, rows: int, poses: int, pitch: float = PITCH) -> vam.Projection:
    """A perfect lens, whose light ends where its pixels end."""
    return vam.Projection(
        GRID, vam.Beam((columns, rows), pitch, spread=0.0), vam.Turntable(poses, lit_share=0), VIAL, "numpy"
    )


@pytest.mark.slow
@pytest.mark.parametrize("where", ["disc", "ring"])
def test_every_column_leaves_its_power_in_the_resin(where: str) -> None:
    """The forward projection of voxels is, for each pixel, the share of its power that these voxels absorb."""
    A, voxels = projection(360, 1, POSES), inside(VIAL.lit_radius)
    if where == "ring":
        voxels &= ~inside(6.0)
    got = A(np.repeat(voxels[:, :, None], 2, axis=2).astype(float))[:, :, 0]
    wanted = shares(A.motion, 360, voxels)
    off = np.abs(got / wanted - 1.0)
    assert wanted.min() > 0.05
    assert off[:, 1:-1].max() < 0.005 and off.mean() < 0.0005, (off[:, 1:-1].max(), off.mean())
    # where the outermost column leaves the vial, its light is three times as dense at one edge of a voxel as at another
    assert off.max() < 0.025


def test_dose_near_the_rim_is_that_of_traced_rays() -> None:
    """Even light from all round: the mean over a voxel of what the ray through each of its points leaves there."""
    A = projection(370, 4, 24)
    factor = A.beam.pixel_area / GRID.voxel_volume
    dose = A.T(np.ones(A.range.shape))[:, :, 0] * factor
    x, y, _ = GRID.axes()
    radius = np.hypot(x[:, None], y[None, :])
    ring = np.argwhere((radius > 6.0) & (radius < 8.2) & inside(VIAL.lit_radius))
    at = np.random.default_rng(7).permutation(ring)[:150]
    nodes, weights = np.polynomial.legendre.leggauss(3)
    dx, dy = (0.5 * VOXEL * part.ravel() for part in np.meshgrid(nodes, nodes))
    px, py = x[at[:, 0], None] + dx, y[at[:, 1], None] + dy
    poses = np.asarray(A.motion.poses)[:, None, None]
    _, share = ray_to(VIAL, poses, px, py, 0.9999 * VIAL.aperture)
    wanted = share.sum(axis=0) @ (0.25 * np.outer(weights, weights).ravel())
    off = dose[at[:, 0], at[:, 1]] / wanted - 1.0
    off, inner = np.abs(off), radius[tuple(at.T)] < 8.19
    assert off[inner].max() < 0.0025 and off.mean() < 0.0002, (off[inner].max(), off.mean())
    assert off.max() < 0.01  # one voxel that reaches to within 0.01 mm of the rim

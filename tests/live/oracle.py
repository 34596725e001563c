"""Images of a print by rays traced through a finer, shifted grid: no operator of the library has a part in them."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter1d

from vamgpu.geometry import Beam, Grid
from vamgpu.optics.traced_rays import traced_rays

FINER = 3
"""Rays a pixel, along columns and along rows."""


def conversion(x: Any, y: Any, z: Any, size: float, edge: float) -> np.ndarray:
    """A part with a hole, a rod beside it and a bar across, soft at its edges; conversion up to 0.9.

    size: half the width of what holds it [mm].  edge: width of the soft edges [mm].
    """
    x, y, z = x / size, y / size, z / size
    depths = (
        (0.9, 0.45 - np.sqrt((x - 0.15) ** 2 + (y + 0.1) ** 2 + 0.5 * z**2)),
        (-0.7, 0.18 - np.hypot(x - 0.2, y + 0.05) + 0.0 * z),
        (0.6, np.minimum(0.14 - np.hypot(x + 0.5, y - 0.3), 0.7 - np.abs(z))),
        (0.4, 0.12 - np.maximum(np.maximum(np.abs(y - 0.45), np.abs(z - 0.3)), np.abs(x) - 0.35)),
    )
    total = sum(share * 0.5 * (1.0 + np.tanh(2.0 * size / edge * depth)) for share, depth in depths)
    return np.clip(total, 0.0, 0.95)


def on_voxels(grid: Grid, edge: float, parts: int = 3) -> np.ndarray:
    """The mean conversion of every voxel, [x, y, z]."""
    offsets = (np.arange(parts) - 0.5 * (parts - 1)) / parts * grid.pitch
    total = np.zeros(grid.shape)
    for dx in offsets:
        for dy in offsets:
            for dz in offsets:
                x, y, z = np.meshgrid(*(a + d for a, d in zip(grid.axes(), (dx, dy, dz), strict=True)), indexing="ij")
                total += conversion(x, y, z, _half(grid), edge)
    return total / parts**3


def images(grid: Grid, beam: Beam, poses: np.ndarray, vessel: Any, full: float, edge: float) -> np.ndarray:
    """Transmitted share of light [angle, row, column]; extinction is ``full`` times the conversion.

    The field stands on voxels half as wide and shifted by a quarter of one, and is read between them along rays.
    """
    fine, shift = 0.5 * grid.pitch, 0.25 * grid.pitch
    n = 2 * max(grid.shape) + 4
    axis = (np.arange(n) - 0.5 * (n - 1)) * fine + shift
    u = (np.arange(FINER * beam.pixels[0]) + 0.5) / FINER * beam.pitch - 0.5 * beam.pixels[0] * beam.pitch
    z = (np.arange(FINER * beam.pixels[1]) + 0.5) / FINER * beam.pitch - 0.5 * beam.pixels[1] * beam.pitch
    field = full * conversion(axis[:, None, None], axis[None, :, None], z[None, None, :], _half(grid), edge)
    rays = traced_rays(vessel, 0.5 * beam.pixels[0] * beam.pitch)
    ways = np.arange(-0.5 * n, 0.5 * n) * fine
    across, stretch = np.empty((ways.size, u.size)), np.empty((ways.size, u.size))
    for k, way in enumerate(ways):
        crossing = rays.cross(way)
        across[k] = np.interp(u, rays.u, crossing.across)
        stretch[k] = fine / np.interp(u, rays.u, crossing.cosine)
    seen = np.empty((poses.size, beam.pixels[1], beam.pixels[0]))
    for k, theta in enumerate(poses):
        x = -across * np.sin(theta) - ways[:, None] * np.cos(theta)
        y = across * np.cos(theta) - ways[:, None] * np.sin(theta)
        light = np.exp(-_along(field, x, y, stretch, axis[0], fine))
        for side in (0, 1):
            light = gaussian_filter1d(light, FINER * beam.sigma, axis=side, mode="nearest")
        seen[k] = light.reshape(beam.pixels[0], FINER, beam.pixels[1], FINER).mean(axis=(1, 3)).T
    return seen


def _along(field: np.ndarray, x: Any, y: Any, stretch: Any, first: float, pitch: float) -> np.ndarray:
    """Bilinear integrals over rays (ways, rays) → (rays, z)."""
    i, j = (x - first) / pitch, (y - first) / pitch
    inside = (i >= 0) & (j >= 0) & (i < field.shape[0] - 1) & (j < field.shape[1] - 1)
    total = np.zeros((x.shape[1], field.shape[2]))
    for way in np.flatnonzero(inside.any(axis=1)):
        ok = np.flatnonzero(inside[way])
        a, b = i[way, ok].astype(int), j[way, ok].astype(int)
        s, t, ds = (v[:, None] for v in (i[way, ok] - a, j[way, ok] - b, stretch[way, ok]))
        near, far = (1 - t) * field[a, b] + t * field[a, b + 1], (1 - t) * field[a + 1, b] + t * field[a + 1, b + 1]
        total[ok] += ds * ((1 - s) * near + s * far)
    return total


def _half(grid: Grid) -> float:
    return 0.5 * max(grid.shape) * grid.pitch

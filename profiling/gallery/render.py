"""Solids as shaded pictures, without a display: points are scattered over the surface into a depth buffer."""

from __future__ import annotations

import numpy as np

from vamgpu.targets.solid import Solid

FINE = 2
"""Number of pixels of the buffer along an edge of a pixel of the picture."""
DENSITY = 14.0
"""Points scattered per pixel of the buffer that a surface covers; enough to leave none empty."""
BASE = np.array([0.36, 0.56, 0.80])


def rendered(solid: Solid, size: int = 260, azimuth: float = -55.0, elevation: float = 28.0) -> np.ndarray:
    """RGB picture [row, column, 3] in 0..1 of a solid from an angle [°], in parallel projection, on white."""
    view = _view(np.radians(azimuth), np.radians(elevation))
    corners = (solid.vertices - solid.vertices.mean(axis=0)) @ view.T
    low, high = corners[:, :2].min(axis=0), corners[:, :2].max(axis=0)
    n = size * FINE
    scale = 0.94 * n / float((high - low).max())
    corners = corners * scale
    corners[:, :2] += 0.5 * n - 0.5 * scale * (low + high)
    place, depth, face, normal = _scattered(corners[solid.faces], n)
    nearest = np.full(n * n, -np.inf)
    np.maximum.at(nearest, place, depth)
    front = depth == nearest[place]
    shade = np.ones((n * n, 3))
    shade[place[front]] = _lit(normal[face[front]])
    picture = _outlined(shade.reshape(n, n, 3), nearest.reshape(n, n))
    return picture.reshape(size, FINE, size, FINE, 3).mean(axis=(1, 3))[::-1]


def _view(azimuth: float, elevation: float) -> np.ndarray:
    """Rows: right, up, and towards the viewer."""
    ca, sa, ce, se = np.cos(azimuth), np.sin(azimuth), np.cos(elevation), np.sin(elevation)
    return np.array([[-sa, ca, 0.0], [-se * ca, -se * sa, ce], [ce * ca, ce * sa, se]])


def _scattered(triangles: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Pixel, depth and face of random points on the triangles that face the viewer, and the normals of all faces."""
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normal = cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-30)
    rng = np.random.default_rng(0)
    wanted = 0.5 * DENSITY * np.maximum(cross[:, 2], 0.0)
    count = np.floor(wanted + rng.random(len(wanted))).astype(int)
    face = np.repeat(np.arange(len(count)), count)
    s, t = rng.random((2, len(face)))
    flip = s + t > 1.0
    s[flip], t[flip] = 1.0 - s[flip], 1.0 - t[flip]
    a, b, c = (triangles[face, k] for k in range(3))
    points = a + s[:, None] * (b - a) + t[:, None] * (c - a)
    column, row = (np.clip(points[:, k].astype(int), 0, n - 1) for k in range(2))
    return row * n + column, points[:, 2], face, normal


def _lit(normal: np.ndarray) -> np.ndarray:
    """Colors of surfaces under a key light, a fill light and the sky; normals as seen by the viewer."""
    key, fill = (np.array(v) / np.linalg.norm(v) for v in ([-0.45, 0.75, 0.6], [0.8, 0.1, 0.5]))
    light = 0.34 + 0.62 * np.clip(normal @ key, 0, 1) + 0.22 * np.clip(normal @ fill, 0, 1)
    return np.clip(BASE * light[:, None] + 0.05 * (light[:, None] - 0.6), 0.0, 1.0)


def _outlined(shade: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """Darken pixels behind a jump of depth, which separates a part from what lies behind it."""
    n = len(depth)
    solid = np.isfinite(depth)
    filled = np.where(solid, depth, -1e3)
    behind = np.zeros((n, n))
    for shift in (1, 2, 3):
        for axis in (0, 1):
            for way in (-shift, shift):
                jump = np.roll(filled, way, axis) - filled
                behind = np.maximum(behind, np.clip((jump - 0.02 * n) / (0.06 * n), 0, 1) / shift)
    return np.where(solid[..., None], shade * (1.0 - 0.45 * behind[..., None]), 1.0)

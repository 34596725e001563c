"""What a face about a roller does to rays that have come to it: a circle about the axis, or the plane of a leg.

Rays are arrays by name: x, y [mm], dx, dy, shares (rays, 2) of the power that s and p light have left, and side, which
is 0 on the roller and ±1 in a leg.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from vamgpu.optics.inputs import Floats
from vamgpu.optics.interface import fresnel


def _normals(rays: dict[str, Any]) -> tuple[Floats, Floats]:
    radius = np.hypot(rays["x"], rays["y"])
    curved = rays["side"] == 0
    return np.where(curved, rays["x"] / radius, rays["side"]), np.where(curved, rays["y"] / radius, 0.0)


def reflect(rays: dict[str, Any], where: np.ndarray) -> None:
    nx, ny = _normals(rays)
    back = np.where(where, 2.0 * (rays["dx"] * nx + rays["dy"] * ny), 0.0)
    rays["dx"], rays["dy"] = rays["dx"] - back * nx, rays["dy"] - back * ny


def refract(rays: dict[str, Any], before: Floats, after: Floats, where: np.ndarray) -> np.ndarray:
    """Cross a face with Snell's law and Fresnel's loss; returns which rays did, the others are totally reflected."""
    nx, ny = _normals(rays)
    facing = rays["dx"] * nx + rays["dy"] * ny
    ratio, cosine = before / after, np.minimum(np.abs(facing), 1.0)
    square = 1.0 - ratio**2 * (1.0 - cosine) * (1.0 + cosine)
    crossed = where & (square >= 0)
    beyond = np.sqrt(np.maximum(square, 0.0))
    bend = np.where(facing < 0, -1.0, 1.0) * (beyond - ratio * cosine)
    same = before == after
    crossing = np.where(same[:, None], 1.0, fresnel(cosine, beyond, before, after))
    change = crossed & ~same
    rays["dx"] = np.where(change, ratio * rays["dx"] + bend * nx, rays["dx"])
    rays["dy"] = np.where(change, ratio * rays["dy"] + bend * ny, rays["dy"])
    rays["shares"] = np.where(crossed[:, None], rays["shares"] * crossing, rays["shares"])
    return crossed

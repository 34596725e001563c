"""The co-rotating medium, and rays that march through it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated

import numpy as np

from vamgpu.kernels.signature import Table

Medium = Annotated[np.ndarray, Table("float32", ("p", "q", "s", "4"))]
"""½∇(n/n_bath)² [1/voxel] and extinction e [1/voxel]; two samples of bath beyond each face, or s = 1.

In an insert, −(k + e/(1 + e)) in place of e: k, 1 to `WHOLE`, is the share of insert."""
Starts = Annotated[np.ndarray, Table("float32", ("ray", "8"))]
"""Across, along [voxels from the axis], height [index of the slice]; direction across, along, up; weight; unused."""
Directions = Annotated[np.ndarray, Table("float32", ("angle", "2"))]  # cosθ, sinθ

BENDS, ABSORBS, BLOCKS = 1, 2, 4
"""Bits of ``kind``: which of the three fields the medium has."""

MARGIN = 2  # samples of bath around the voxels
SOLID = 0.397  # interpolated share of insert that stops light: walls that touch by their edges leak from 0.44 on
WHOLE = 64.0  # value of a sample that is all insert
DARK = 28.0  # share of insert from which a voxel gets no light


def march(
    medium: np.ndarray, starts: np.ndarray, directions: np.ndarray, top: float, step: float, most: int, kind: int,
    left: np.ndarray,
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:  # fmt: skip
    """Rays that still travel (flat index over angle and ray), middles of their steps (index of x, y, z), weights."""
    # Sets ``left`` to −1 for rays that still travel after ``most`` steps.
    high = np.array([medium.shape[0] - MARGIN - 1.0, medium.shape[1] - MARGIN - 1.0, top])
    position, heading, light, inside = enter(medium, starts, directions, high)
    ray = np.flatnonzero(inside)
    position, heading, light = position[ray], heading[ray], light[ray]
    pull = look_up(medium, position)[0][:, :3]
    for _ in range(most):
        if not ray.size:
            return
        following, turned, pull = advance(medium, position, heading, pull, step, kind)
        middle, length = 0.5 * (position + following), 0.5 * step * np.linalg.norm(heading + turned, axis=1)
        weight, blocked = light * length, np.zeros(ray.size, bool)
        if kind & (ABSORBS | BLOCKS):
            values, opacity = look_up(medium, middle)
            if kind & ABSORBS:
                weight = -light * np.expm1(-values[:, 3] * length)
                light = light - weight
            if kind & BLOCKS:
                blocked = opacity > SOLID
                weight = np.where(blocked, 0.0, weight)
        yield ray, middle, weight
        on = ~blocked & ((following >= -MARGIN) & (following <= high)).all(axis=1)
        ray, position, heading, light, pull = ray[on], following[on], turned[on], light[on], pull[on]
    left[ray] = -1


def enter(
    medium: np.ndarray, starts: np.ndarray, directions: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Where rays of every angle enter the medium, their headings, weights, and which do: (angle · ray, …)."""
    c, s = directions[:, 0, None], directions[:, 1, None]
    middle = 0.5 * (np.array(medium.shape[:2]) - 2 * MARGIN - 1)
    level = np.ones_like(c)

    def turned(across: np.ndarray, along: np.ndarray, up: np.ndarray) -> np.ndarray:
        return np.stack([-across * s - along * c, across * c - along * s, up * level], axis=2).reshape(-1, 3)

    origin = turned(*starts.T[:3]) + np.append(middle, 0.0)
    heading = turned(*starts.T[3:6])
    slow = np.abs(heading) < 1e-9
    inverse = 1.0 / np.where(slow, 1.0, heading)
    first, second = (-MARGIN - origin) * inverse, (high - origin) * inverse
    within = (origin >= -MARGIN) & (origin <= high)
    near = np.where(slow, np.where(within, -1e9, 1e9), np.minimum(first, second)).max(axis=1)
    far = np.where(slow, 1e9, np.maximum(first, second)).min(axis=1)
    near = np.maximum(near, 0.0)
    light = np.tile(starts[:, 6], directions.shape[0])
    return origin + near[:, None] * heading, heading, light, (near < far) & (light > 0)


def advance(
    medium: np.ndarray, position: np.ndarray, heading: np.ndarray, pull: np.ndarray, step: float, kind: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position, heading and ½∇n² after one step."""
    if not kind & BENDS:
        return position + step * heading, heading, pull
    a = step * pull
    b = step * look_up(medium, position + step * (0.5 * heading + 0.125 * a))[0][:, :3]
    pull = look_up(medium, position + step * (heading + 0.5 * b))[0][:, :3]
    turned = heading + (a + 4.0 * b + step * pull) / 6.0
    return position + step * (heading + (a + 2.0 * b) / 6.0), turned, pull


def look_up(medium: np.ndarray, position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The medium, interpolated, and the share of insert; (rays, 4), (rays,)."""
    axes = 2 if medium.shape[2] == 1 else 3
    at = np.clip(position[:, :axes] + MARGIN, 0.0, np.array(medium.shape[:axes]) - 1.0)
    below = np.minimum(at.astype(int), np.array(medium.shape[:axes]) - 2)
    near = np.stack([1 + below - at, at - below], axis=2).T
    values, opacity = np.zeros((len(at), 4)), np.zeros(len(at))
    for corner in np.ndindex(*(2,) * axes):
        weight = np.prod([near[end, axis] for axis, end in enumerate(corner)], axis=0)
        index = below + corner
        node = medium[tuple(index.T)] if axes == 3 else medium[index[:, 0], index[:, 1], 0]
        stands = node[:, 3] < 0
        insert = np.where(stands, np.floor(-node[:, 3]), 0.0)
        rest = np.where(stands, -node[:, 3] - insert, 0.0)
        opacity += weight * insert / WHOLE
        values[:, :3] += weight[:, None] * node[:, :3]
        values[:, 3] += weight * np.where(stands, rest / (1.0 - rest), node[:, 3])
    return values, opacity

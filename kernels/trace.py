"""Rays marched through what the resin carries: a refractive index, an extinction, opaque inserts.

d²R/dt² = ½∇n² with dt = ds/n, stepped by the Runge-Kutta-Nyström rule of fourth order of A. Sharma, D. Kumar &
A. Ghatak, Appl. Opt. 21 (1982) 984; the field at a step's foreseen end, a third-order distance from its true one,
serves the next step too. Lengths are counted in voxels and indices in that of the bath, so that the
parameter of a ray is its length wherever nothing is carried. What a step loses is shared out to the voxels around its
middle by their bi- or trilinear weights.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated

import numpy as np

from vamgpu.kernels.signature import Field, Integer, Real, Table, Tiling, Volume, VolumeOut, kernel

Medium = Annotated[np.ndarray, Table("float32", ("p", "q", "s", "4"))]
"""½∇(n/n_bath)² [1/voxel] and extinction [1/voxel], −1 where opaque; two samples of bath beyond each face, or s = 1."""
Starts = Annotated[np.ndarray, Table("float32", ("ray", "8"))]
"""Across, along [voxels from the axis], height [index of the slice]; direction across, along, up; weight; unused."""
Directions = Annotated[np.ndarray, Table("float32", ("angle", "2"))]  # cosθ, sinθ
Steps = Annotated[np.ndarray, Table("int32", ("angle", "pixel"))]
StepsOut = Annotated[np.ndarray, Table("int32", ("angle", "pixel"), writes=True)]
CountsOut = Annotated[np.ndarray, Table("int32", ("angle", "ray"), writes=True)]
EntriesOut = Annotated[np.ndarray, Table("float32", ("angle", "ray", "capacity", "2"), writes=True)]
Rows = Annotated[np.ndarray, Field(("angle", "r", "row"))]
RowsOut = Annotated[np.ndarray, Field(("angle", "r", "row"), writes=True)]

BENDS, ABSORBS, BLOCKS = 1, 2, 4
"""Bits of ``kind``: which of the three the resin carries."""

MARGIN = 2      # samples of bath around the voxels
SOLID = 0.397   # interpolated share of insert that stops light: walls that touch by their edges leak from 0.44 on


@kernel(over="counts")
def trace_entries(
    medium: Medium,
    starts: Starts,
    directions: Directions,
    step: Real,
    most: Integer,
    kind: Integer,
    counts: CountsOut,
    entries: EntriesOut,
) -> None:
    """Rays that stay level in a medium without z, as sparse rows: pairs of a cell x·n_y + y and its weight.

    A cell is written when its ray has passed it, so that it comes once. counts: pairs of each ray, those beyond the
    capacity included, or −1 for a ray that has not left after ``most`` steps.
    """
    nx, ny = medium.shape[0] - 2 * MARGIN, medium.shape[1] - 2 * MARGIN
    total, capacity = counts.size, entries.shape[2]
    count, pairs = np.zeros(total, int), entries.reshape(total, capacity, 2)
    corner, held = np.full((total, 2), -9), np.zeros((total, 2, 2))

    def write(ray: np.ndarray, cell: np.ndarray, weight: np.ndarray) -> None:
        real = (weight > 0) & (cell >= 0).all(axis=1) & (cell < (nx, ny)).all(axis=1)
        ray, cell, weight = ray[real], cell[real], weight[real]
        room = count[ray] < capacity
        pairs[ray[room], count[ray[room]]] = np.stack([cell[room] @ (ny, 1), weight[room]], axis=1)
        count[ray] += 1

    def pass_on(ray: np.ndarray, new: np.ndarray) -> None:
        kept = np.zeros((ray.size, 2, 2))
        for a, b in np.ndindex(2, 2):
            cell, weight = corner[ray] + (a, b), held[ray, a, b]
            at = cell - new
            near = ((at == 0) | (at == 1)).all(axis=1)
            kept[near, at[near, 0], at[near, 1]] = weight[near]
            write(ray[~near], cell[~near], weight[~near])
        corner[ray], held[ray] = new, kept

    for ray, middle, weight in march(medium, starts, directions, 1e6, step, most, kind, count):
        below = np.floor(middle[:, :2]).astype(int)
        moved = (below != corner[ray]).any(axis=1)
        pass_on(ray[moved], below[moved])
        beyond = middle[:, :2] - below
        for a, b in np.ndindex(2, 2):
            held[ray, a, b] += weight * np.abs(1 - a - beyond[:, 0]) * np.abs(1 - b - beyond[:, 1])
    lost = count < 0
    every = np.arange(total)
    pass_on(every, np.full((total, 2), -9))
    count[lost] = -1
    counts[...] = count.reshape(counts.shape)


@kernel(over="steps")
def survey_rays(
    medium: Medium,
    starts: Starts,
    directions: Directions,
    top: Real,
    step: Real,
    most: Integer,
    kind: Integer,
    steps: StepsOut,
) -> None:
    """Steps the longest ray of each pixel takes, or −1 where one has not left after ``most``. top: end of z."""
    total = directions.shape[0] * starts.shape[0]
    count = np.zeros(total, int)
    taken = np.zeros(total, int)
    for ray, _, _ in march(medium, starts, directions, top, step, most, kind, count):
        taken[ray] += 1
    taken[count < 0] = -1
    bundles = taken.reshape(*steps.shape, -1)
    steps[...] = np.where((bundles < 0).any(axis=2), -1, bundles.max(axis=2))


@kernel(over="steps")
def forward_traced(
    volume: Volume,
    medium: Medium,
    starts: Starts,
    directions: Directions,
    steps: Steps,
    step: Real,
    kind: Integer,
    lanes: Integer,
    sinogram: RowsOut,
) -> None:
    """sinogram[a, r, row] = Σ over the steps of a pixel's rays of weight × volume, trilinear. lanes: its own."""
    total = np.zeros(directions.shape[0] * starts.shape[0])
    unused = np.zeros(total.size, int)
    top, most = volume.shape[2] + 1, max(int(steps.max()), 0)
    for ray, middle, weight in march(medium, starts, directions, top, step, most, kind, unused):
        for cell, share in nodes(medium, volume.shape, middle, kind):
            total[ray] += weight * share * volume[tuple(cell.T)]
    sinogram[...] = total.reshape(*sinogram.shape, -1).sum(axis=3)


@kernel(over="steps")
def back_traced(
    sinogram: Rows,
    medium: Medium,
    starts: Starts,
    directions: Directions,
    steps: Steps,
    step: Real,
    kind: Integer,
    lanes: Integer,
    volume: VolumeOut,
) -> None:
    """The transpose, added to ``volume``: every ray leaves its light at the very voxels it would have looked at."""
    bundle = directions.shape[0] * starts.shape[0] // sinogram.size
    light = np.repeat(sinogram.ravel(), bundle)
    unused = np.zeros(light.size, int)
    top, most = volume.shape[2] + 1, max(int(steps.max()), 0)
    for ray, middle, weight in march(medium, starts, directions, top, step, most, kind, unused):
        for cell, share in nodes(medium, volume.shape, middle, kind):
            np.add.at(volume, tuple(cell.T), weight * share * light[ray])


@kernel(over="volume", cpu=Tiling(major=1, minor=0), gpu=Tiling(major=1, minor=1))
def clear_volume(volume: VolumeOut) -> None:
    """volume = 0."""
    volume[...] = 0.0


# ---- what the definitions share ------------------------------------------------------------------------------------
def march(
    medium: np.ndarray, starts: np.ndarray, directions: np.ndarray, top: float, step: float, most: int, kind: int,
    left: np.ndarray,
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:  # fmt: skip
    """Rays under way (a flat index over angle and ray), the middles of their steps (index of x, y, z), and weights.

    Sets ``left`` to −1 for rays still under way after ``most`` steps.
    """
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
    """Where the rays of every pose enter the medium, their headings and weights, and which do: (angle · ray, …)."""
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
    beyond = at - below
    values, opacity = np.zeros((len(at), 4)), np.zeros(len(at))
    for corner in np.ndindex(*(2,) * axes):
        weight = np.prod(np.abs(1 - np.array(corner) - beyond), axis=1)
        index = below + corner
        node = medium[tuple(index.T)] if axes == 3 else medium[index[:, 0], index[:, 1], 0]
        opacity += weight * (node[:, 3] < 0)
        values[:, :3] += weight[:, None] * node[:, :3]
        values[:, 3] += weight * np.maximum(node[:, 3], 0.0)
    return values, opacity


def nodes(
    medium: np.ndarray, shape: tuple[int, ...], middle: np.ndarray, kind: int
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """The eight voxels around each point and their shares, 0 for those beyond the grid and for inserts."""
    below = np.floor(middle).astype(int)
    beyond = middle - below
    for corner in np.ndindex(2, 2, 2):
        cell = below + corner
        share = np.prod(np.abs(1 - np.array(corner) - beyond), axis=1)
        share *= ((cell >= 0) & (cell < shape)).all(axis=1)
        cell = np.clip(cell, 0, np.array(shape) - 1)
        if kind & BLOCKS:
            up = cell[:, 2] + MARGIN if medium.shape[2] > 1 else 0
            share *= medium[cell[:, 0] + MARGIN, cell[:, 1] + MARGIN, up, 3] >= 0
        yield cell, share

"""Rays through a co-rotating medium: the cells that each crosses, and its number of steps."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from vamgpu.kernels.medium import MARGIN, Directions, Medium, Starts, march
from vamgpu.kernels.signature import Integer, Real, Table, kernel

StepsOut = Annotated[np.ndarray, Table("int32", ("angle", "pixel"), writes=True)]
CountsOut = Annotated[np.ndarray, Table("int32", ("angle", "ray"), writes=True)]
EntriesOut = Annotated[np.ndarray, Table("float32", ("angle", "ray", "capacity", "2"), writes=True)]


@kernel(over="counts")
def trace_entries(
    medium: Medium, starts: Starts, directions: Directions, step: Real, most: Integer, kind: Integer, counts: CountsOut,
    entries: EntriesOut,
) -> None:  # fmt: skip
    """Horizontal rays in a medium that does not depend on z, as sparse rows: pairs of a cell x·n_y + y and weight."""
    # A cell is written when its ray has passed it; each cell is therefore written once. counts: pairs of each ray,
    # including those beyond the capacity, or −1 for a ray that has not left after ``most`` steps.
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
    medium: Medium, starts: Starts, directions: Directions, top: Real, step: Real, most: Integer, kind: Integer,
    steps: StepsOut,
) -> None:  # fmt: skip
    """Number of steps of each pixel's longest ray; −1 if one is still inside after ``most``. top: upper end in z."""
    total = directions.shape[0] * starts.shape[0]
    count = np.zeros(total, int)
    taken = np.zeros(total, int)
    for ray, _, _ in march(medium, starts, directions, top, step, most, kind, count):
        taken[ray] += 1
    taken[count < 0] = -1
    bundles = taken.reshape(*steps.shape, -1)
    steps[...] = np.where((bundles < 0).any(axis=2), -1, bundles.max(axis=2))

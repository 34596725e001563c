"""Rays through a medium whose refractive index n varies: d²R/dt² = ½∇n²(R) with dt = ds/n, marched in equal steps of t.

The heading T = dR/dt is the optical direction: along the ray, as long as the index. Three steppers: 0 is Sharma's
Runge-Kutta-Nyström scheme of fourth order (Applied Optics 21, 984, 1982), 1 the symplectic leapfrog of second order,
2 Yoshida's symplectic composition of three leapfrogs, of fourth order (Physics Letters A 150, 262, 1990).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated

import numpy as np

from vamgpu.kernels.signature import Integer, Real, Table, kernel

Starts = Annotated[np.ndarray, Table("float32", ("ray", "6"))]
"""Place and heading."""
Formula = Annotated[np.ndarray, Table("float32", ("12",))]
"""n² = P(s) / Q(s), s = a·x² + b·y² + c·z²: a, b, c, P from the constant to the cube, Q likewise, and a spare."""
Plane = Annotated[np.ndarray, Table("float32", ("i", "j"))]
Volume = Annotated[np.ndarray, Table("float32", ("i", "j", "k"))]
"""Coefficients of the cubic B-splines of n², one more on every side than there are cells' corners."""
Corner = Annotated[np.ndarray, Table("float32", ("4",))]
"""Place of the first corner of the first cell, and cells per length."""
Region = Annotated[np.ndarray, Table("float32", ("10",))]
"""A ray has left where a·x² + b·y² + c·z² > q or it is outside a box: a, b, c, q, low corner, high corner."""
Ends = Annotated[np.ndarray, Table("float32", ("ray", "8"), writes=True)]
"""Place, heading, optical path, length."""
Path = Annotated[np.ndarray, Table("float32", ("ray", "row", "3"), writes=True)]
Times = Annotated[np.ndarray, Table("float32", ("ray",), writes=True)]

Look = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Places (rays, 3) → ½∇n² (rays, 3) and n² (rays,)."""

OUTER = 1.0 / (2.0 - 2.0 ** (1.0 / 3.0))
LEAPS = {1: (1.0,), 2: (OUTER, 1.0 - 2.0 * OUTER, OUTER)}
SHORTEN = 5
"""Newton steps that find where a ray crosses the border of the region."""


@kernel(over="times")
def march_formula(
    starts: Starts, formula: Formula, region: Region, step: Real, steps: Integer, scheme: Integer, every: Integer,
    ends: Ends, path: Path, times: Times,
) -> None:  # fmt: skip
    """March rays through n² = P(s)/Q(s) until they leave the region, at most ``steps`` steps.

    The last step is shortened to end on the border. path[ray, k] is the place after k·every steps, the end's after it.
    times: t at the border, or −1 for a ray that is still inside after the last step.
    """
    march(lambda place: formula_at(formula, place), starts, region, step, steps, scheme, every, ends, path, times)


@kernel(over="times")
def march_plane(
    starts: Starts, coefficients: Plane, corner: Corner, region: Region, step: Real, steps: Integer, scheme: Integer,
    every: Integer, ends: Ends, path: Path, times: Times,
) -> None:  # fmt: skip
    """`march_formula` through n²(x, y) made of cubic B-splines; beyond the grid its outermost cells continue."""
    march(lambda place: plane_at(coefficients, corner, place), starts, region, step, steps, scheme, every, ends, path,
          times)  # fmt: skip


@kernel(over="times")
def march_volume(
    starts: Starts, coefficients: Volume, corner: Corner, region: Region, step: Real, steps: Integer, scheme: Integer,
    every: Integer, ends: Ends, path: Path, times: Times,
) -> None:  # fmt: skip
    """`march_formula` through n²(x, y, z) made of cubic B-splines; beyond the grid its outermost cells continue."""
    march(lambda place: volume_at(coefficients, corner, place), starts, region, step, steps, scheme, every, ends, path,
          times)  # fmt: skip


# ---- fields ------------------------------------------------------------------------------------------------------
def formula_at(formula: np.ndarray, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """½∇n² and n² of P(s)/Q(s)."""
    weights, p, q = formula[:3], formula[3:7], formula[7:11]
    s = (place**2) @ weights
    above, below = (c[0] + s * (c[1] + s * (c[2] + s * c[3])) for c in (p, q))
    d_above, d_below = (c[1] + s * (2.0 * c[2] + 3.0 * s * c[3]) for c in (p, q))
    square = above / below
    slope = (d_above - square * d_below) / below
    return slope[:, None] * weights * place, square


def bspline(fraction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weights of the four cubic B-splines over a cell, and their slopes; each (rays, 4)."""
    f, g = fraction, 1.0 - fraction
    weights = [g**3, 4.0 - 3.0 * f**2 * (1.0 + g), 4.0 - 3.0 * g**2 * (1.0 + f), f**3]
    slopes = [-(g**2), f * (3.0 * f - 4.0), g * (4.0 - 3.0 * g), f**2]
    return np.stack(weights, axis=-1) / 6.0, np.stack(slopes, axis=-1) / 2.0


def cell_of(position: np.ndarray, corners: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Index of the cell, and the weights and slopes of its coefficients, for positions counted in cells."""
    cell = np.clip(position.astype(int), 0, corners - 4)
    return (cell, *bspline(np.clip(position - cell, -2.0, 3.0)))


def plane_at(coefficients: np.ndarray, corner: np.ndarray, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """½∇n² and n² of B-splines in x and y."""
    position = (place[:, :2] - corner[:2]) * corner[3]
    i, wx, dx = cell_of(position[:, 0], coefficients.shape[0])
    j, wy, dy = cell_of(position[:, 1], coefficients.shape[1])
    taps = np.arange(4)
    block = coefficients[(i[:, None] + taps)[:, :, None], (j[:, None] + taps)[:, None, :]]
    along_y, slope_y = np.einsum("rab,rb->ra", block, wy), np.einsum("rab,rb->ra", block, dy)
    gradient = np.zeros_like(place)
    gradient[:, 0], gradient[:, 1] = np.sum(along_y * dx, axis=1), np.sum(slope_y * wx, axis=1)
    return 0.5 * corner[3] * gradient, np.sum(along_y * wx, axis=1)


def volume_at(coefficients: np.ndarray, corner: np.ndarray, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """½∇n² and n² of B-splines in x, y and z."""
    position = (place - corner[:3]) * corner[3]
    i, wx, dx = cell_of(position[:, 0], coefficients.shape[0])
    j, wy, dy = cell_of(position[:, 1], coefficients.shape[1])
    k, wz, dz = cell_of(position[:, 2], coefficients.shape[2])
    taps = np.arange(4)
    rows = (i[:, None] + taps)[:, :, None, None], (j[:, None] + taps)[:, None, :, None]
    block = coefficients[(*rows, (k[:, None] + taps)[:, None, None, :])]
    even, steep = np.einsum("rabc,rc->rab", block, wz), np.einsum("rabc,rc->rab", block, dz)
    gradient = np.stack([np.einsum("rab,ra,rb->r", rest, x, y)
                         for rest, x, y in ((even, dx, wy), (even, wx, dy), (steep, wx, wy))], axis=1)  # fmt: skip
    return 0.5 * corner[3] * gradient, np.einsum("rab,ra,rb->r", even, wx, wy)


# ---- marching ----------------------------------------------------------------------------------------------------
def march(
    look: Look, starts: np.ndarray, region: np.ndarray, step: float, steps: int, scheme: int, every: int,
    ends: np.ndarray, path: np.ndarray, times: np.ndarray,
) -> None:  # fmt: skip
    """What the kernels of this file do, through any field; see `march_formula`."""
    state = State(look, starts)
    path[:, 0], times[...] = starts[:, :3], -1.0
    live = np.arange(len(starts))
    for k in range(int(steps)):
        now = state.part(live)
        after = now.advanced(look, np.full(live.size, step), scheme)
        out, _ = _outside(after, region)
        gone = out > 0.0
        if gone.any():
            last, h = _to_border(look, now.part(np.flatnonzero(gone)), step, scheme, region)
            after.put(np.flatnonzero(gone), last)
            times[live[gone]] = k * step + h
        state.put(live, after)
        live = live[~gone]
        if (k + 1) % every == 0 and (k + 1) // every < path.shape[1]:
            path[:, (k + 1) // every] = state.place
        if not live.size:
            break
    done = k // every + 1 if steps else 1
    path[:, done:] = state.place[:, None, :]
    ends[:, :3], ends[:, 3:6], ends[:, 6], ends[:, 7] = state.place, state.heading, state.optical, state.length


class State:
    """Where rays are: place, heading, ½∇n² and n² there, optical path and length so far."""

    def __init__(self, look: Look | None, starts: np.ndarray) -> None:
        self.place, self.heading = starts[:, :3].copy(), starts[:, 3:6].copy()
        self.optical, self.length = np.zeros(len(starts)), np.zeros(len(starts))
        if look is not None:
            self.pull, self.square = look(self.place)

    def part(self, index: np.ndarray) -> State:
        """A copy of some rays."""
        few = State(None, np.zeros((0, 6)))
        for name in ("place", "heading", "pull", "square", "optical", "length"):
            setattr(few, name, getattr(self, name)[index])
        return few

    def put(self, index: np.ndarray, few: State) -> None:
        """Replace some rays."""
        for name in ("place", "heading", "pull", "square", "optical", "length"):
            getattr(self, name)[index] = getattr(few, name)

    def advanced(self, look: Look, step: np.ndarray, scheme: int) -> State:
        """After one step; the paths by the cubic through values and slopes at both ends, of fourth order."""
        end, h = self.part(np.arange(len(self.place))), step[:, None]
        if scheme == 0:
            a = self.pull
            b, _ = look(self.place + h * (0.5 * self.heading + 0.125 * h * a))
            c, _ = look(self.place + h * (self.heading + 0.5 * h * b))
            end.place = self.place + h * (self.heading + h / 6.0 * (a + 2.0 * b))
            end.heading = self.heading + h / 6.0 * (a + 4.0 * b + c)
            end.pull, end.square = look(end.place)
        for share in LEAPS.get(int(scheme), ()):
            end.heading = end.heading + 0.5 * share * h * end.pull
            end.place = end.place + share * h * end.heading
            end.pull, end.square = look(end.place)
            end.heading = end.heading + 0.5 * share * h * end.pull
        first, last = np.sum(self.pull * self.heading, axis=1), np.sum(end.pull * end.heading, axis=1)
        n0, n1 = np.sqrt(self.square), np.sqrt(end.square)
        end.optical = self.optical + step * (0.5 * (self.square + end.square) + step / 6.0 * (first - last))
        end.length = self.length + step * (0.5 * (n0 + n1) + step / 12.0 * (first / n0 - last / n1))
        return end


def _outside(state: State, region: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How far outside the region, below zero inside, on the way out only; and its growth per t."""
    place, heading = state.place, state.heading
    round_value = (place**2) @ region[:3] - region[3]
    values = np.concatenate([round_value[:, None], region[4:7] - place, place - region[7:10]], axis=1)
    growth = np.concatenate([(2.0 * (place * heading) @ region[:3])[:, None], -heading, heading], axis=1)
    values = np.where(growth > 0.0, values, -1e30)
    worst = np.argmax(values, axis=1)[:, None]
    return np.take_along_axis(values, worst, 1)[:, 0], np.take_along_axis(growth, worst, 1)[:, 0]


def _to_border(look: Look, now: State, step: float, scheme: int, region: np.ndarray) -> tuple[State, np.ndarray]:
    """The step that ends on the border, and its size."""
    h = np.full(len(now.place), step)
    for _ in range(SHORTEN):
        value, growth = _outside(now.advanced(look, h, scheme), region)
        h = np.clip(h - np.where(value > -1e29, value / np.maximum(growth, 1e-30), 0.0), 0.0, step)
    return now.advanced(look, h, scheme), h

"""Rays through a medium whose refractive index n varies: d²R/dt² = ½∇n²(R) with dt = ds/n, in equal steps of t."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from vamgpu.kernels.index_field import Corner, Formula, Look, Plane, Volume, formula_at, plane_at, volume_at
from vamgpu.kernels.signature import Integer, Real, Table, kernel

Starts = Annotated[np.ndarray, Table("float32", ("ray", "6"))]
"""Place and heading."""
Region = Annotated[np.ndarray, Table("float32", ("10",))]
"""A ray has left if a·x² + b·y² + c·z² > q or if it is outside a box: a, b, c, q, low corner, high corner."""
Ends = Annotated[np.ndarray, Table("float32", ("ray", "8"), writes=True)]
"""Place, heading, optical path, length."""
Path = Annotated[np.ndarray, Table("float32", ("ray", "row", "3"), writes=True)]
Times = Annotated[np.ndarray, Table("float32", ("ray",), writes=True)]

OUTER = 1.0 / (2.0 - 2.0 ** (1.0 / 3.0))
LEAPS: dict[int, tuple[float, ...]] = {1: (1.0,), 2: (OUTER, 1.0 - 2.0 * OUTER, OUTER)}
SHORTEN = 5
"""Newton steps for finding where a ray crosses the border of the region."""


@kernel(over="times")
def march_formula(
    starts: Starts, formula: Formula, region: Region, step: Real, steps: Integer, scheme: Integer, every: Integer,
    ends: Ends, path: Path, times: Times,
) -> None:  # fmt: skip
    """March rays through n² = P(s)/Q(s) until they leave the region, at most ``steps`` steps."""
    # The last step is shortened to end on the border. path[ray, k] is the position after k·every steps, the last the
    # end. times: t at the border, or −1 for a ray that is still inside after the last step.
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


def march(
    look: Look, starts: np.ndarray, region: np.ndarray, step: float, steps: int, scheme: int, every: int,
    ends: np.ndarray, path: np.ndarray, times: np.ndarray,
) -> None:  # fmt: skip
    """March rays through any field, as the kernels of this file do; see `march_formula`."""
    state = State.begun(look, starts)
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


@dataclass
class State:
    """State of rays: place, heading, ½∇n² and n² there, optical path and length so far."""

    place: np.ndarray
    heading: np.ndarray
    optical: np.ndarray
    length: np.ndarray
    pull: np.ndarray
    square: np.ndarray

    @classmethod
    def begun(cls, look: Look, starts: np.ndarray) -> State:
        """Rays at positions with headings, (rays, 6), before their first step."""
        place, none = starts[:, :3].copy(), np.zeros(len(starts))
        return cls(place, starts[:, 3:6].copy(), none, none.copy(), *look(place))

    def part(self, index: np.ndarray) -> State:
        """A copy of some rays."""
        return State(*(each[index] for each in vars(self).values()))

    def put(self, index: np.ndarray, few: State) -> None:
        """Replace some rays."""
        for name, each in vars(self).items():
            each[index] = getattr(few, name)

    def advanced(self, look: Look, step: np.ndarray, scheme: int) -> State:
        """State after one step; paths follow from the cubic through values and slopes at both ends, of fourth order."""
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
    """Distance outside the region (below zero inside) of rays on their way out, and its growth per t."""
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

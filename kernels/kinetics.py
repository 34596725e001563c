"""Photoinhibition by two inhibitors: visible light uses up A and B, B recombines to C, UV splits C into B."""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np

from vamgpu.kernels.signature import Integer, Real, Table, kernel

Before = Annotated[np.ndarray, Table("float32", ("item", "4"))]
"""[A], [B], [C] and the visible dose so far."""
Rates = Annotated[np.ndarray, Table("float32", ("resin", "8"))]
"""k_A, k_B, k_C, k₂, the scale of concentrations, [C]_ref (0: order 0), and two spares."""
Light = Annotated[np.ndarray, Table("float32", ("source", "interval", "2"))]
"""Visible and UV irradiance."""
Lengths = Annotated[np.ndarray, Table("float32", ("interval",))]
After = Annotated[np.ndarray, Table("float32", ("item", "4"), writes=True)]
Path = Annotated[np.ndarray, Table("float32", ("item", "row", "4"), writes=True)]
Times = Annotated[np.ndarray, Table("float32", ("item",), writes=True)]

DEPLETED = 1e-6
"""Share of the scale below which [A] + [B] counts as 0."""
MOST = 20000
"""Steps within one interval after which an item counts as one that does not converge."""
FLOOR = 1e-12
"""Lower limit of [A] + [B] as a divisor, as a share of the scale."""
NEVER, UNSETTLED = -1.0, -2.0
SAFETY, SHRINK, GROW = 0.9, 0.2, 4.0


@kernel(over="times")
def inhibit(
    before: Before, rates: Rates, light: Light, lengths: Lengths, first: Integer, count: Integer, every: Integer,
    tolerance: Real, after: After, path: Path, times: Times,
) -> None:  # fmt: skip
    """Advance items through ``count`` intervals of constant light, from ``first`` on, cyclically."""
    # Items are in equal runs of one resin each, with the sources of light in turn. path[i, k]: after k·every intervals.
    # times: when [A] + [B] reached `DEPLETED` of the scale, after which A and B stay 0 and C and the dose do not
    # change; −1 if it did not, −2 if the steps did not converge. tolerance: of a step, in the scale.
    items, intervals = len(before), len(lengths)
    own = rates[np.arange(items) * len(rates) // items]
    source = np.arange(items) % len(light)
    state, clock = before.copy(), 0.0
    times[...] = np.where(state[:, 0] + state[:, 1] <= DEPLETED * own[:, 4], 0.0, NEVER)
    state[times == 0.0, :2] = 0.0
    trial = np.full(items, np.inf)
    path[:, 0] = state
    for k in range(int(count)):
        now = (int(first) + k) % intervals
        live = np.flatnonzero(times == NEVER)
        lit = light[source[live], now]
        state[live, :3], spent, trial[live], failed = _interval(
            state[live, :3], own[live], lit, float(lengths[now]), trial[live], float(tolerance)
        )
        done = state[live, 0] + state[live, 1] == 0.0
        times[live[done]] = clock + spent[done]
        times[live[failed]] = UNSETTLED
        state[live, 3] += lit[:, 0] * spent
        clock += float(lengths[now])
        if (k + 1) % every == 0 and (k + 1) // every < path.shape[1]:
            path[:, (k + 1) // every] = state
    path[:, int(count) // int(every) + 1 :] = state[:, None]
    after[...] = state


class _Terms(NamedTuple):
    """Rates of each item during a step: those in the present light, and [C]_ref or 0."""

    a: np.ndarray
    b: np.ndarray
    p: np.ndarray
    k2: np.ndarray
    slope: np.ndarray
    """p/[C]_ref of order 1, 0 of order 0."""
    scale: np.ndarray
    steady: np.ndarray
    """Whether the order is 0."""


def _terms(state: np.ndarray, own: np.ndarray, lit: np.ndarray) -> _Terms:
    """Rates for a step from ``state``. For order 0 without C, recombined B is split again at once, but no more."""
    p, k2, reference = own[:, 2] * lit[:, 1], own[:, 3], own[:, 5]
    steady = reference == 0.0
    slides = steady & (state[:, 2] <= 0.0) & (p >= k2 * state[:, 1] ** 2)
    p, k2 = np.where(slides, 0.0, p), np.where(slides, 0.0, k2)
    slope = np.where(steady, 0.0, p / np.where(steady, 1.0, reference))
    return _Terms(own[:, 0] * lit[:, 0], own[:, 1] * lit[:, 0], p, k2, slope, own[:, 4], steady)


def _shares(state: np.ndarray, terms: _Terms) -> tuple[np.ndarray, np.ndarray]:
    """[A] + [B], with a lower limit, and the share of A in it."""
    whole = np.maximum(state[:, 0] + state[:, 1], FLOOR * terms.scale)
    return whole, np.clip(state[:, 0] / whole, 0.0, 1.0)


def _change(state: np.ndarray, terms: _Terms) -> np.ndarray:
    """d/dt of [A], [B], [C]; (items, 3)."""
    _, share = _shares(state, terms)
    made = np.where(terms.steady, terms.p, terms.slope * state[:, 2])
    paired = terms.k2 * state[:, 1] ** 2
    rest = np.minimum(1.0 - share, np.abs(state[:, 1]) / (FLOOR * terms.scale))
    return np.stack([-terms.a * share, -terms.b * rest + 2.0 * (made - paired), paired - made], axis=1)


def _reach(state: np.ndarray, change: np.ndarray, terms: _Terms) -> np.ndarray:
    """Time that [A] + [B], and for order 0 also [C], would last at their present rates."""
    fall = -(change[:, 0] + change[:, 1])
    whole = state[:, 0] + state[:, 1] - 0.5 * DEPLETED * terms.scale
    reach = np.where(fall > 0.0, whole / np.where(fall > 0.0, fall, 1.0), np.inf)
    ends = terms.steady & (change[:, 2] < 0.0)
    return np.minimum(reach, np.where(ends, state[:, 2] / np.where(ends, -change[:, 2], 1.0), np.inf))


def _rodas3(state: np.ndarray, change: np.ndarray, terms: _Terms, h: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The state after a step and its estimated error; the matrix (2/h)·1 − J is tridiagonal in A, B, C."""
    whole, share = _shares(state, terms)
    g, pull, push = 2.0 / h, terms.a / whole, terms.b / whole
    rest, pair = 1.0 - share, 2.0 * terms.k2 * state[:, 1]
    first, last = g + pull * rest, g + terms.slope
    pivot = g + push * share * g / first + 2.0 * pair * g / last

    def solved(right: np.ndarray) -> np.ndarray:
        middle = (right[:, 1] + push * rest * right[:, 0] / first + 2.0 * terms.slope * right[:, 2] / last) / pivot
        return np.stack([(right[:, 0] + pull * share * middle) / first, middle,
                         (right[:, 2] + pair * middle) / last], axis=1)  # fmt: skip

    per = 1.0 / h[:, None]
    k1 = solved(change)
    k2 = solved(change + 4.0 * per * k1)
    base = state + 2.0 * k1
    k3 = solved(_change(base, terms) + per * (k1 - k2))
    k4 = solved(_change(base + k3, terms) + per * (k1 - k2 - 8.0 / 3.0 * k3))
    return base + k3 + k4, np.abs(k4).max(axis=1)


def _settled(state: np.ndarray, end: np.ndarray, terms: _Terms) -> np.ndarray:
    """The end of a step with traces below 0 removed; missing B is taken from C, and the reverse."""
    a, b, c = np.maximum(end[:, 0], 0.0), end[:, 1], end[:, 2]
    used = terms.steady & (c <= DEPLETED * terms.scale) & (c < state[:, 2])
    moved = np.where(used, c, np.minimum(c, 0.0))
    b, c = b + 2.0 * moved, c - moved
    below = np.minimum(b, 0.0)
    return np.stack([a, b - below, np.maximum(c + 0.5 * below, 0.0)], axis=1)


def _interval(
    state: np.ndarray, own: np.ndarray, lit: np.ndarray, length: float, trial: np.ndarray, tolerance: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """States after an interval or at their event, the time until then, next step sizes, and failed items."""
    state, trial, spent = state.copy(), trial.copy(), np.zeros(len(state))
    live = np.arange(len(state)) if length > 0.0 else np.arange(0)
    for _ in range(MOST):
        if not live.size:
            break
        y = state[live]
        terms = _terms(y, own[live], lit[live])
        change, left = _change(y, terms), length - spent[live]
        h = np.minimum(np.minimum(trial[live], left), _reach(y, change, terms))
        end, error = _rodas3(y, change, terms, h)
        error /= tolerance * terms.scale
        good = (error <= 1.0) & (end >= -tolerance * terms.scale[:, None]).all(axis=1)
        grown = np.clip(SAFETY / np.cbrt(np.maximum(error, 1e-6)), SHRINK, GROW)
        short = np.where(h < trial[live], trial[live], 0.0)
        trial[live] = np.where(good, np.maximum(h * grown, short), h * np.minimum(grown, 0.5))
        end = _settled(y, end, terms)
        gone = end[:, 0] + end[:, 1] <= DEPLETED * terms.scale
        end[gone, :2] = 0.0
        state[live[good]] = end[good]
        over = good & (gone | (h >= left))
        spent[live] += np.where(good, h, 0.0)
        live = live[~over]
    failed = np.zeros(len(state), bool)
    failed[live] = True
    return state, spent, trial, failed & (length > 0.0)

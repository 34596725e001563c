"""Position of the roller's axis on the mirrors, from a photodiode's scan of one lit line, whose shadow has two edges.

Source: J. Toombs et al., "Roll-to-roll tomographic volumetric additive manufacturing", section S6.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from vamgpu.calibration.fits import check_finite, noise_of
from vamgpu.errors import BadInput, ShapeMismatch
from vamgpu.geometry import counts, positive

LEAST_CONTRAST = 6.0  # smallest step from shadow to light, over the noise of a reading, that counts as an edge

LEAST_COLUMNS = 16  # least number of readings of a scan, and on either side of an edge for its fit

SHARP = 0.15  # blur [columns] below which a column's own width hides it

NEAR = 20.0  # range of the fit on either side of an edge, in widths of its blur


@dataclass(frozen=True)
class Edge:
    """One edge of the shadow, in columns of the mirrors counted from 0."""

    column: float  # where half the light passes
    width: float  # standard deviation of its blur
    error: float  # standard error of column
    rising: bool  # light comes after the shadow


@dataclass(frozen=True)
class RollerAxis:
    """The axis of a roller on the mirrors, in columns counted from 0."""

    column: float  # of the axis
    radius: float  # of the roller in columns, measured if there are two edges, else as given
    error: float  # standard error of the column
    edges: tuple[Edge, ...]

    def shift(self, columns: int, *, flip_r: bool = False) -> float:
        """Shift along r [pixels] for `pack` that centers frames of ``columns`` on the roller's axis."""
        middle = 0.5 * (counts("columns", (columns,), 1)[0] - 1)
        return middle - self.column if flip_r else self.column - middle


def find_axis(light: ArrayLike, columns: ArrayLike | None = None, *, radius: float | None = None) -> RollerAxis:
    """The axis, from readings (columns,) of a photodiode while mirrors are lit line by line. Raises `BadInput`."""
    place, read = _readings(light, columns)
    known = None if radius is None else positive("radius [columns]", radius)
    (low, high), noise = (float(q) for q in np.quantile(read, (0.03, 0.97))), noise_of(read)
    if not high - low > LEAST_CONTRAST * noise:
        raise BadInput(
            f"the readings go from {low:.4g} to {high:.4g} with a noise of {noise:.2g}; expected a shadow "
            f"{LEAST_CONTRAST:g} times deeper than the noise: light the roller, average readings"
        )
    crossings = _crossings(read, low, high, noise)
    if not 1 <= len(crossings) <= 2:
        where = ", ".join(f"{place[at]:g}" for at, _ in crossings) or "none"
        raise BadInput(
            f"the scan has {len(crossings)} edges between light and shadow (columns {where}); expected the two of a "
            "roller: scan past it on both sides, and remove other objects that cast shadows"
        )
    ends = [0, *(at for at, _ in crossings), place.size]
    cuts = [0, *((a + b) // 2 for a, b in zip(ends[1:-2], ends[2:-1], strict=True)), place.size]
    edges = [_edge(place, read, at, rising, range(cuts[n], cuts[n + 1])) for n, (at, rising) in enumerate(crossings)]
    return _axis(tuple(edges), known)


def _axis(edges: tuple[Edge, ...], radius: float | None) -> RollerAxis:
    if len(edges) == 2:
        first, last = edges
        if first.rising or not last.rising:
            raise BadInput(
                f"light lies between columns {first.column:.1f} and {last.column:.1f} and shadow outside; expected the "
                "roller's shadow between two edges: swap the reading's sign, or scan around the roller"
            )
        error = 0.5 * float(np.hypot(first.error, last.error))
        return RollerAxis(0.5 * (first.column + last.column), 0.5 * (last.column - first.column), error, edges)
    (edge,) = edges
    if radius is None:
        raise BadInput(
            f"the scan has one edge, at column {edge.column:.1f}, which does not tell where the axis is; expected "
            "both edges, or radius= in columns"
        )
    return RollerAxis(edge.column + (-radius if edge.rising else radius), radius, edge.error, edges)


def _readings(light: ArrayLike, columns: ArrayLike | None) -> tuple[np.ndarray, np.ndarray]:
    read = np.asarray(light, np.float64)
    place = np.arange(read.size, dtype=np.float64) if columns is None else np.asarray(columns, np.float64)
    if read.ndim != 1 or place.shape != read.shape:
        raise ShapeMismatch(f"readings have shape {read.shape} and columns {place.shape}; expected one for each")
    if read.size < LEAST_COLUMNS:
        raise BadInput(f"the scan has {read.size} readings; expected {LEAST_COLUMNS} or more")
    check_finite("readings or columns", read, place)
    if (np.diff(place) <= 0).any():
        raise BadInput("the columns of the scan do not rise; expected each line once, in order")
    return place, read


def _crossings(read: np.ndarray, low: float, high: float, noise: float) -> list[tuple[int, bool]]:
    """First reading after every transition between light and shadow, and whether it is into light; noise is ignored."""
    middle, slack = 0.5 * (low + high), min(0.3 * (high - low), max(0.1 * (high - low), 5.0 * noise))
    bright = bool(np.median(read[: max(3, read.size // 100)]) > middle)
    found: list[tuple[int, bool]] = []
    side = np.where(read > middle + slack, 1, np.where(read < middle - slack, -1, 0))
    last = 0
    for at in np.flatnonzero(side):
        if (side[at] > 0) != bright:
            bright = not bright
            inside = read[last : at + 1] > middle
            found.append((last + int(np.argmax(inside if bright else ~inside)), bright))
        last = int(at)
    return found


def _step(x: np.ndarray, column: float, shadow: float, light: float, tilt: float, width: float) -> np.ndarray:
    """A blurred step from shadow to light that may grow with x, seen by a line one column wide; width < 0: it falls."""
    from scipy.special import ndtr

    def below(u: np.ndarray) -> np.ndarray:
        """Integral of the normal distribution up to u."""
        return u * ndtr(u) + np.exp(-0.5 * u**2) / np.sqrt(2.0 * np.pi)

    u, half = (x - column) / width, 0.5 / width
    past = 0.5 * (below(u + half) - below(u - half)) / half
    return shadow + (light + tilt * (x - column) - shadow) * past


def _edge(place: np.ndarray, read: np.ndarray, at: int, rising: bool, room: range) -> Edge:
    """The edge, fitted first over the whole available range and then close by, where uneven light matters less."""
    found = _fitted(place, read, at, rising, slice(room.start, room.stop))
    pace = float(np.median(np.diff(place)))
    near = max(LEAST_COLUMNS, round(NEAR * found.width / pace))
    return _fitted(place, read, at, rising, slice(max(at - near, room.start), min(at + near, room.stop)))


def _fitted(place: np.ndarray, read: np.ndarray, at: int, rising: bool, part: slice) -> Edge:
    """A blurred step, fitted to some readings around a transition."""
    from scipy.optimize import OptimizeWarning, curve_fit

    x, y = place[part] - place[at], read[part]
    low, high = float(y.min()), float(y.max())
    pace = float(np.median(np.diff(place)))
    sharp = SHARP if rising else -SHARP
    start = (0.0, 0.0, 1.0, 0.0, 2.0 * pace if rising else -2.0 * pace)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", OptimizeWarning)
            found, covariance = curve_fit(_step, x, (y - low) / (high - low), p0=start, maxfev=4000)
            if abs(found[4]) <= SHARP or not np.isfinite(covariance[0, 0]):
                fixed = partial(_step, width=sharp)
                found, covariance = curve_fit(fixed, x, (y - low) / (high - low), p0=start[:4], maxfev=4000)
                found = np.append(found, sharp)
    except (RuntimeError, TypeError) as error:
        raise BadInput(f"no step fits the edge at column {place[at]:g}: {error}; scan further past it") from error
    column, width = float(found[0]), float(found[4])
    if not x[0] < column < x[-1] or (width > 0) != rising:
        raise BadInput(
            f"the edge at column {place[at]:g} fits a step at {place[at] + column:.1f}, outside its readings "
            f"{place[part][0]:g} to {place[part][-1]:g}; scan further past the roller"
        )
    return Edge(float(place[at]) + column, abs(width), float(np.sqrt(covariance[0, 0])), rising)

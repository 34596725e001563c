"""The smallest circle around a set of points in the plane."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from vamgpu.errors import BadInput
from vamgpu.schema.quantities import numeric

Circle = tuple[float, float, float]  # center x, center y, radius

_SLACK = 1e-12  # relative tolerance of "inside": points on the rim count as covered despite rounding


def smallest_enclosing_circle(points: npt.ArrayLike) -> Circle:
    """Return (x, y, radius) of the smallest circle that contains all points."""
    array = numeric("points", points, (2,), "finite coordinates (n, 2): clean the mesh first")
    if array.shape[1] != 2:
        raise BadInput(f"points has shape {array.shape}; expected (n, 2) with n >= 1")
    rim = _hull(array)
    # Far from the origin, rounding errors of the products below would be large.
    shift = rim.mean(axis=0)
    order = np.random.default_rng(0).permutation(len(rim))
    x, y, radius = _grow(rim[order] - shift)
    return float(x + shift[0]), float(y + shift[1]), float(radius)


def _hull(points: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    from scipy.spatial import ConvexHull, QhullError

    if len(points) < 4:
        return points
    try:
        return points[ConvexHull(points).vertices]
    except QhullError:  # all points on one line: its two ends, which are extreme in x or in y
        return points[[*np.argmin(points, axis=0), *np.argmax(points, axis=0)]]


def _grow(points: npt.NDArray[np.float64]) -> Circle:
    """Grow the circle point by point in a fixed shuffled order: Welzl's algorithm, in expected linear time."""
    circle: Circle = (float(points[0, 0]), float(points[0, 1]), 0.0)
    for i in range(1, len(points)):
        if _holds(circle, points[i]):
            continue
        circle = (float(points[i, 0]), float(points[i, 1]), 0.0)
        for j in range(i):
            if _holds(circle, points[j]):
                continue
            circle = _through_two(points[i], points[j])
            for k in range(j):
                if not _holds(circle, points[k]):
                    circle = _through_three(points[i], points[j], points[k])
    return circle


def _holds(circle: Circle, point: npt.NDArray[np.float64]) -> bool:
    x, y, radius = circle
    return bool(np.hypot(point[0] - x, point[1] - y) <= radius * (1.0 + _SLACK))


def _through_two(a: npt.NDArray[np.float64], b: npt.NDArray[np.float64]) -> Circle:
    middle = 0.5 * (a + b)
    return float(middle[0]), float(middle[1]), float(0.5 * np.hypot(*(a - b)))


def _through_three(a: Any, b: Any, c: Any) -> Circle:
    ab, ac = b - a, c - a
    twice_area = 2.0 * (ab[0] * ac[1] - ab[1] * ac[0])
    if twice_area == 0.0:  # on one line: the two farthest apart
        return max((_through_two(a, b), _through_two(a, c), _through_two(b, c)), key=lambda circle: circle[2])
    ux = (ac[1] * (ab @ ab) - ab[1] * (ac @ ac)) / twice_area
    uy = (ab[0] * (ac @ ac) - ac[0] * (ab @ ab)) / twice_area
    return float(a[0] + ux), float(a[1] + uy), float(np.hypot(ux, uy))

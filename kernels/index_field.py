"""Squared refractive index and half its gradient at given positions: rational formulas, and cubic B-splines."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated

import numpy as np

from vamgpu.kernels.signature import Table

Formula = Annotated[np.ndarray, Table("float32", ("12",))]
"""n² = P(s) / Q(s), s = a·x² + b·y² + c·z²: a, b, c, P from the constant to the cube, Q likewise, and a spare."""
Plane = Annotated[np.ndarray, Table("float32", ("i", "j"))]
Volume = Annotated[np.ndarray, Table("float32", ("i", "j", "k"))]
"""Coefficients of the cubic B-splines of n², one more on every side than the corners of cells."""
Corner = Annotated[np.ndarray, Table("float32", ("4",))]
"""Position of the first corner of the first cell, and cells per length."""

Look = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Positions (rays, 3) → ½∇n² (rays, 3) and n² (rays,)."""


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

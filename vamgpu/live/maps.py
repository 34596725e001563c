"""Pictures of what is believed of a print: two cuts through a field, and where the part's surface shall be."""

from __future__ import annotations

import numpy as np

from vamgpu.errors import ShapeMismatch
from vamgpu.geometry import positive
from vamgpu.reports.chart import colored

TALL = 160
"""Least height of a picture [pixels]."""
GAP = 6
"""Between the cuts [pixels]."""
OUTLINE = np.array([255, 255, 255], np.uint8)


def cuts(field: np.ndarray, part: np.ndarray, most: float, colors: str = "magma") -> np.ndarray:
    """A cut across the axis beside one along it, the part outlined in both.

    Args:
        field: Values, [x, y, z].
        part: Fractions, [x, y, z].
        most: Value of the brightest color, in the field's unit.
        colors: A matplotlib color map.

    Returns:
        The picture, uint8 [row, column, color]: x to the right; y, and z, upwards.

    Raises:
        ShapeMismatch: Field and part are of unlike grids.
        BadInput: ``most`` is not above 0.
    """
    most = positive("most", most)
    if np.ndim(field) != 3 or np.shape(field) != np.shape(part):
        raise ShapeMismatch(
            f"the field has shape {np.shape(field)}, the part {np.shape(part)}; expected [x, y, z] of one grid"
        )
    nx, ny, nz = field.shape
    drawn = [
        _drawn(field[:, :, nz // 2].T, part[:, :, nz // 2].T, most, colors),
        _drawn(field[:, ny // 2].T, part[:, ny // 2].T, most, colors),
    ]
    high = max(len(each) for each in drawn)
    sheet = np.zeros((high, sum(each.shape[1] for each in drawn) + GAP, 3), np.uint8)
    left = 0
    for each in drawn:
        sheet[(high - len(each)) // 2 :][: len(each), left : left + each.shape[1]] = each
        left += each.shape[1] + GAP
    return sheet


def _drawn(plane: np.ndarray, part: np.ndarray, most: float, colors: str) -> np.ndarray:
    zoom = max(1, -(-TALL // max(plane.shape)))
    values, inside = (np.kron(each[::-1], np.ones((zoom, zoom))) for each in (plane / most, part >= 0.5))
    pixels = colored(values, colors)
    solid = inside > 0.5
    edge = np.zeros_like(solid)
    edge[1:] |= solid[1:] & ~solid[:-1]
    edge[:-1] |= solid[:-1] & ~solid[1:]
    edge[:, 1:] |= solid[:, 1:] & ~solid[:, :-1]
    edge[:, :-1] |= solid[:, :-1] & ~solid[:, 1:]
    pixels[edge] = OUTLINE
    return pixels

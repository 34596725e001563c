"""Pictures of the estimated print: two cuts through a field, with the intended surface of the part."""

from __future__ import annotations

from typing import Any

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.errors import ShapeMismatch
from vamgpu.geometry import positive
from vamgpu.live.fields import picked, places
from vamgpu.reports.chart import colored

BRIGHT = 1.5  # dose of the brightest color, relative to the dose from which resin is solid
TALL = 160  # least height of a picture [pixels]
GAP = 6  # distance between the cuts [pixels]
OUTLINE = np.array([255, 255, 255], np.uint8)


def cuts(field: Any, part: np.ndarray, most: float, colors: str = "magma") -> np.ndarray:
    """A cut across the axis next to one along it, uint8 [row, column, color]; the part is outlined in both."""
    most = positive("most", most)
    shape = field.shape if isinstance(field, DeviceArray) else np.shape(field)
    if len(shape) != 3 or shape != np.shape(part):
        raise ShapeMismatch(f"the field has shape {shape}, the part {np.shape(part)}; expected [x, y, z] of one grid")
    middles = (2, shape[2] // 2), (1, shape[1] // 2)
    drawn = [_drawn(_cut(field, *each).T, _cut(part, *each).T, most, colors) for each in middles]
    high = max(len(each) for each in drawn)
    sheet = np.zeros((high, sum(each.shape[1] for each in drawn) + GAP, 3), np.uint8)
    left = 0
    for each in drawn:
        sheet[(high - len(each)) // 2 :][: len(each), left : left + each.shape[1]] = each
        left += each.shape[1] + GAP
    return sheet


def _cut(field: Any, axis: int, at: int) -> np.ndarray:
    """The plane ``at`` along an axis."""
    if not isinstance(field, DeviceArray):
        return np.take(field, at, axis)
    indices = [np.arange(count) for count in field.shape]
    indices[axis] = indices[axis][at : at + 1]
    numbers = np.ravel_multi_index(np.ix_(*indices), field.shape)
    found = picked(field, places(field.device, numbers.reshape(-1), field.shape))
    return found.reshape(numbers.shape).squeeze(axis)


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

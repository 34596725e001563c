"""Pictures of volumes and sinograms as data URLs."""

from __future__ import annotations

from math import ceil, sqrt
from typing import Any

import numpy as np

from vamgpu.reports.chart import colored, picture
from vamgpu.reports.page import Image

SLICES = 64  # greatest number of slices in the viewer

EDGE = 192  # greatest edge of a slice in the viewer [px]

GAMMA = 2.2  # patterns are shown to the power 1 / `GAMMA`, because their mean is only a fortieth of their peak

HIT, MISSING, EXCESS, OUTSIDE = 1, 2, 3, 4  # verdicts on a voxel; 0 is a voxel that is correctly unprinted

_VERDICTS = np.array([0, EXCESS, MISSING, HIT], np.uint8)
"""Verdicts: outside, outside and printed, in the part but not printed, in the part and printed."""

COLORS = np.array([[246, 247, 249], [176, 190, 208], [214, 58, 73], [240, 150, 32], [255, 255, 255]], np.uint8)
"""Color of each verdict."""


def ramp(name: str) -> list[int]:
    """256 RGB triples of a matplotlib color map in one flat list."""
    return colored(np.linspace(0, 1, 256), name).ravel().tolist()


def verdicts(target: np.ndarray, printed: np.ndarray, cylinder: np.ndarray) -> np.ndarray:
    """uint8 [x, y, z]: right, `HIT`, `MISSING`, `EXCESS`, or `OUTSIDE` the judged cylinder [x, y]."""
    verdict = _VERDICTS[2 * (target >= 0.5).view(np.uint8) + printed.view(np.uint8)]
    verdict[~cylinder] = OUTSIDE
    return verdict


def upright(plane: np.ndarray) -> np.ndarray:
    """A plane [horizontal, vertical] as rows of a picture; the vertical axis points up."""
    return plane.T[::-1]


def sheet(dose: np.ndarray, target: np.ndarray, verdict: np.ndarray, peak: float) -> dict[str, Any]:
    """Slices along z in one picture: red is dose over peak, green the target, blue the verdict times 40."""
    nx, ny, nz = dose.shape
    step = max(1, ceil(max(nx, ny) / EDGE))
    chosen = np.unique(np.linspace(0, nz - 1, min(nz, SLICES)).round().astype(int))
    across = ceil(sqrt(len(chosen)))
    dose, target, verdict = (values[::step, ::step][:, :, chosen] for values in (dose, target, verdict))
    channels = (np.clip(dose / (peak or 1.0), 0, 1) * 255, np.clip(target, 0, 1) * 255, verdict * 40.0)
    tiles = [[upright(channel[:, :, k]) for channel in channels] for k in range(len(chosen))]
    height, width = tiles[0][0].shape
    pixels = np.zeros((ceil(len(chosen) / across) * height, across * width, 3), np.uint8)
    for index, tile in enumerate(tiles):
        row, column = divmod(index, across)
        pixels[row * height : (row + 1) * height, column * width : (column + 1) * width] = np.stack(tile, -1).round()
    return {"image": picture(pixels), "slices": chosen.tolist(), "across": across, "width": width, "height": height}


def viewer(sheet: dict[str, Any], heights: list[float], first: int) -> dict[str, Any]:
    """Data of the page's slices: their image, their z [mm], and the slice to show first."""
    return {"sheet": sheet, "heights": heights, "first": first, "heat": ramp("magma"), "colors": COLORS.tolist()}


def cuts(dose: np.ndarray, target: np.ndarray, verdict: np.ndarray, peak: float) -> list[list[Image]]:
    """Target, dose and verdict in the planes x = 0 and y = 0."""
    found = []
    for axis, name in ((0, "x = 0"), (1, "y = 0")):
        middle = dose.shape[axis] // 2
        expected, given, verdict_here = (upright(np.take(a, middle, axis)) for a in (target, dose, verdict))
        found.append(
            [
                Image(picture(247 - (np.clip(expected, 0, 1) * 191).astype(np.uint8)), f"target, {name}"),
                Image(picture(colored(given / (peak or 1.0), "magma")), f"dose, {name}, upright"),
                Image(picture(COLORS[verdict_here]), f"printed, {name}"),
            ]
        )
    return found


def sinogram(light: np.ndarray, full: float) -> Image:
    """The middle row [angle, r] of a sinogram [angle, r, z], angles downwards."""
    return Image(_bright(light[:, :, light.shape[2] // 2], full), "Light of the middle row over all angles")


def frames(light: np.ndarray, full: float, angles: np.ndarray, count: int = 4) -> list[Image]:
    """``count`` frames [z, r] as they leave the projector, and their angles [°]."""
    chosen = [round(k * light.shape[0] / count) for k in range(min(count, light.shape[0]))]
    return [Image(_bright(upright(light[k]), full), f"{angles[k % len(angles)]:g}°") for k in chosen]


def _bright(light: np.ndarray, full: float) -> str:
    """Patterns with a gamma of `GAMMA`."""
    return picture(colored((light / full) ** (1.0 / GAMMA), "inferno"))

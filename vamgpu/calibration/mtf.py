"""Modulation transfer of a projector (and the camera), from a picture of a slanted edge: ISO 12233. The edge is that of
a blurred step fitted to all pixels; losses from binning and from differences of neighbors are compensated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from vamgpu.calibration.fits import check_finite, fitted, noise_of
from vamgpu.errors import BadInput
from vamgpu.geometry import positive

OVERSAMPLE = 4  # bins a pixel
LEAST_CONTRAST = 8.0  # least step of the edge, relative to the noise of a pixel
LEAST_SLANT = 2.0
"""Least number of pixels that the edge crosses over the picture, so that its sub-pixel positions are even."""
FLAT, REACH = 4.0, 6.0
"""Distances from the edge, in widths of the blur: within `FLAT` all values count fully, beyond `REACH` none does."""
NARROWEST = 8.0  # lower limit of that range [pixels]

FREQUENCIES = 401


@dataclass(frozen=True)
class EdgeResponse:
    """The modulation transfer function of an edge, and its blur."""

    frequency: np.ndarray  # [1/mm], rising from 0 to half a cycle per pixel
    modulation: np.ndarray  # at each, 1 at 0
    half: float  # frequency [1/mm] at which half the modulation remains
    angle: float  # of the edge against the nearer axis of the camera [deg]
    width: float  # standard deviation [mm] of the Gaussian blur nearest to the edge's
    contrast: float  # (light − dark) / (light + dark)
    width_error: float = 0.0  # standard error of the width [mm]


def slanted_edge(picture: ArrayLike, pixel: float) -> EdgeResponse:
    """The modulation transfer across a slanted edge; ``pixel`` of the camera in its plane [mm]. Raises `BadInput`."""
    pitch, light = positive("pixel [mm]", pixel), _upright(picture)
    _contrast(light)
    (low, high, column, slope, width), width_error = _line(light)
    across = abs(slope) * (light.shape[0] - 1)
    if across < LEAST_SLANT:
        raise BadInput(
            f"the edge moves by {across:.2g} pixels from the first to the last row; expected {LEAST_SLANT:g} or more: "
            "turn the camera or the edge by about 5°"
        )
    spread, lines = _spread(light, column, slope, width)
    frequency, modulation = _transform(spread, lines, width)
    half = _half(frequency, modulation)
    return EdgeResponse(
        frequency / pitch, modulation, half / pitch, float(np.degrees(np.arctan(slope))), width * pitch,
        abs(high - low) / max(high + low, 1e-12), width_error * pitch,
    )  # fmt: skip


def _upright(picture: ArrayLike) -> np.ndarray:
    """The picture as float64, turned to have its edge closer to columns than to rows."""
    light = np.asarray(picture, np.float64)
    if light.ndim != 2 or min(light.shape) < 16:
        raise BadInput(f"the picture has shape {light.shape}; expected [row, column] of 16 × 16 pixels at least")
    check_finite("pixels of the picture", light)
    along, across = (float(np.ptp(light.mean(axis=axis))) for axis in (1, 0))
    return light.T if along > across else light


def _contrast(light: np.ndarray) -> None:
    noise = noise_of(light)
    low, high = (float(q) for q in np.quantile(light, (0.05, 0.95)))
    if not high - low > LEAST_CONTRAST * noise:
        raise BadInput(
            f"the picture goes from {low:.4g} to {high:.4g} with a noise of {noise:.2g}; expected an edge "
            f"{LEAST_CONTRAST:g} times higher than the noise: light it, expose longer"
        )


def _step(at: np.ndarray, low: float, high: float, column: float, slope: float, width: float) -> np.ndarray:
    """A straight blurred step; ``at`` holds columns and rows, counted from the middle row."""
    from scipy.special import ndtr

    distance = (at[0] - column - slope * at[1]) / np.hypot(1.0, slope)
    return low + (high - low) * ndtr(distance / width)


def _line(light: np.ndarray) -> tuple[tuple[float, float, float, float, float], float]:
    """Dark, light, column at the middle row, columns a row and blur [pixels] of a fitted step; error of the blur."""
    rows, columns = light.shape
    row, column = np.meshgrid(np.arange(rows) - 0.5 * (rows - 1), np.arange(columns, dtype=float), indexing="ij")
    low, high = (float(light[:, part].mean()) for part in (slice(0, columns // 8), slice(-(columns // 8), None)))
    share = (light.mean(axis=1) - low) / (high - low) if high != low else np.full(rows, 0.5)
    first = columns * (1.0 - np.clip(share, 0.05, 0.95))
    slope, middle = np.polyfit(np.arange(rows) - 0.5 * (rows - 1), first, 1)
    at = np.stack([column.ravel(), row.ravel()])
    found, covariance = fitted(
        _step, at, light.ravel(), (low, high, middle, slope, 3.0), "no edge fits the picture",
        "show one edge between dark and light", evaluations=400,
    )  # fmt: skip
    dark, bright, place, tilt, width = (float(value) for value in found)
    if not 0.0 < place < columns - 1.0:
        raise BadInput(f"the edge lies at column {place:.1f} of {columns}; expected it inside the picture: center it")
    return (dark, bright, place, tilt, abs(width)), float(np.sqrt(covariance[4, 4]))


def _spread(light: np.ndarray, column: float, slope: float, width: float) -> tuple[np.ndarray, np.ndarray]:
    """The line spread: differences of the edge in bins of 1/4 pixel; and their distances from the edge [pixels]."""
    rows, columns = light.shape
    row, place = np.meshgrid(np.arange(rows) - 0.5 * (rows - 1), np.arange(columns, dtype=float), indexing="ij")
    distance = (place - column - slope * row) / np.hypot(1.0, slope)
    bent = abs(slope) * 0.5 * (rows - 1)
    room = min(column, columns - 1.0 - column) - bent
    reach = min(max(REACH * width, NARROWEST), room)
    if reach < FLAT * width or reach < 0.5 * NARROWEST:
        raise BadInput(
            f"the edge is blurred by {width:.3g} pixels and has {room:.3g} pixels beside it; expected "
            f"{max(FLAT * width, 0.5 * NARROWEST):.3g}: center it, or use a wider view"
        )
    count = int(reach * OVERSAMPLE)
    index = np.floor(distance * OVERSAMPLE).astype(int) + count
    inside = (index >= 0) & (index < 2 * count)
    number = np.bincount(index[inside], minlength=2 * count)
    total = np.bincount(index[inside], weights=light[inside], minlength=2 * count)
    if (number == 0).any():
        raise BadInput(
            f"{int((number == 0).sum())} of {2 * count} distances from the edge have no pixel; slant it more"
        )
    lines = np.arange(1 - count, count) / OVERSAMPLE
    return np.diff(total / number), lines


def _transform(spread: np.ndarray, lines: np.ndarray, width: float) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies [cycles/pixel] up to half the camera's, and the modulation, corrected for bins and differences."""
    reach = float(np.abs(lines).max()) + 1.0 / OVERSAMPLE
    flat = min(max(FLAT * width, 0.5 * NARROWEST), 0.8 * reach)
    fade = np.clip((np.abs(lines) - flat) / (reach - flat), 0.0, 1.0)
    windowed = spread * 0.5 * (1.0 + np.cos(np.pi * fade))
    frequency = np.linspace(0.0, 0.5, FREQUENCIES)
    transform = np.abs(np.exp(-2j * np.pi * frequency[:, None] * lines[None, :]) @ windowed)
    return frequency, transform / transform[0] / np.sinc(frequency / OVERSAMPLE) ** 2


def _half(frequency: np.ndarray, modulation: np.ndarray) -> float:
    """Frequency at half the modulation; between two frequencies the modulation is that of a Gaussian blur."""
    below = np.flatnonzero(modulation < 0.5)
    if not below.size:
        raise BadInput(
            f"the modulation is still {modulation[-1]:.2f} at half a cycle per pixel; expected it to fall below 0.5: "
            "move the camera closer"
        )
    at = int(below[0])
    ends, squares = np.log(np.maximum(modulation[at - 1 : at + 1], 1e-12)), frequency[at - 1 : at + 1] ** 2
    return float(np.sqrt(squares[0] + (squares[1] - squares[0]) * (ends[0] - np.log(0.5)) / (ends[0] - ends[1])))

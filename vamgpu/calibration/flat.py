"""Flat field of full-on mirrors, from readings of a photodiode while they are lit block by block."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial.legendre import legvander
from numpy.typing import ArrayLike

from vamgpu.calibration.fits import check_finite
from vamgpu.errors import BadInput, ShapeMismatch

ORDER = 4  # total order of the surface's polynomial along rows and columns: tilt, vignetting, and effects of lenses

LEAST_CONTRAST = 20.0  # least light of a block, relative to the noise of its mean


@dataclass(frozen=True, eq=False)
class FlatReading:
    """Relative brightness of full-on mirrors, the brightest 1."""

    field: np.ndarray  # [row, column]
    error: float  # greatest standard error of a mirror
    left: float  # standard deviation of the blocks about the surface
    noise: float

    @property
    def dimmest(self) -> float:
        """Brightness of the dimmest mirror."""
        return float(self.field.min())


def cuts(length: int, count: int) -> np.ndarray:
    """Borders of ``count`` blocks of mirrors, as even as whole mirrors allow; shape (count + 1,). Raises `BadInput`."""
    if not 1 <= count <= length:
        raise BadInput(f"{count} blocks of {length} mirrors; expected 1 to {length}")
    return np.rint(np.linspace(0, length, count + 1)).astype(int)


def fit_flat(readings: ArrayLike, dark: ArrayLike, mirrors: tuple[int, int], order: int = ORDER) -> FlatReading:
    """Smooth surface that best fits readings [row block, column block, repeat]. Raises `BadInput`, `ShapeMismatch`."""
    read, base = np.asarray(readings, np.float64), np.asarray(dark, np.float64)
    if read.ndim != 3 or read.shape[2] < 2 or base.ndim != 1 or not base.size:
        raise ShapeMismatch(
            f"readings have shape {read.shape} and dark ones {base.shape}; expected (blocks, blocks, 2 or more) and "
            "(1 or more,)"
        )
    check_finite("readings", read, base)
    down, across = (cuts(length, count) for length, count in zip(mirrors, read.shape[:2], strict=True))
    area = np.outer(np.diff(down), np.diff(across))
    light = (read.mean(axis=2) - base.mean()) / area
    noise = float(np.sqrt(read.var(axis=2, ddof=1).mean() / read.shape[2]))
    if not (light * area).min() > LEAST_CONTRAST * noise:
        raise BadInput(
            f"a block gives {(light * area).min():.3g} with a noise of {noise:.2g}; expected {LEAST_CONTRAST:g} times "
            "the noise or more: light the meter, use larger blocks, average more readings"
        )
    rows, columns = (legvander(np.linspace(-1.0, 1.0, length), order) for length in mirrors)
    terms = [(i, j) for i in range(order + 1) for j in range(order + 1 - i)]
    if light.size < 2 * len(terms):
        raise BadInput(
            f"{light.size} blocks for a surface of {len(terms)} terms; expected {2 * len(terms)} or more: use more "
            "blocks along rows and columns"
        )
    low, wide = (np.add.reduceat(part, borders[:-1], axis=0) / np.diff(borders)[:, None]
                 for part, borders in ((rows, down), (columns, across)))  # fmt: skip
    means = np.stack([np.outer(low[:, i], wide[:, j]).ravel() for i, j in terms], axis=1)
    found, *_ = np.linalg.lstsq(means, light.ravel(), rcond=None)
    off = light.ravel() - means @ found
    left = float(np.sqrt(off @ off / (light.size - len(terms))))
    surface = np.zeros((order + 1, order + 1))
    for value, (i, j) in zip(found, terms, strict=True):
        surface[i, j] = value
    field = rows @ surface @ columns.T
    if field.min() <= 0:
        raise BadInput("the surface falls below 0; expected light on every block: use more blocks, check the meter")
    covariance = np.linalg.pinv(means.T @ means)
    spread = np.zeros(mirrors)
    for a, (i, j) in enumerate(terms):
        for b, (k, m) in enumerate(terms):
            spread += covariance[a, b] * np.outer(rows[:, i] * rows[:, k], columns[:, j] * columns[:, m])
    top, typical = float(field.max()), noise / float(area.mean())
    return FlatReading(field / top, float(np.sqrt(spread.max())) * left / top, left / top, typical / top)

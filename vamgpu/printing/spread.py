"""Spread of the light of rows and columns: a lit box, blurred by a Gaussian and averaged over voxels in closed form."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, sqrt
from typing import NamedTuple

import numpy as np

from vamgpu.geometry import Beam
from vamgpu.optics.traced_rays import Rays

TAIL = 4.5  # standard deviations at which a Gaussian is cut off: 7e-6 of it lies beyond


@dataclass(frozen=True)
class PixelSpread:
    """The light of one pixel."""

    # column, row: standard deviations along columns and along rows, in pixels. bins: number into which a column's width
    # is divided. beyond: column widths on either side of the beam that its light reaches.

    side: float  # of the lit box
    column: float
    row: float
    bins: int

    @property
    def beyond(self) -> int:
        """Column widths on either side of the beam that its light reaches."""
        return ceil(TAIL * self.column)

    def reach(self, beam: Beam) -> float:
        """Farthest light from the middle of the beam [mm]."""
        return (0.5 * beam.pixels[0] + self.beyond) * beam.pitch


class ColumnShares(NamedTuple):
    """Light of the bins from that of columns: first column of each bin (bins,), and shares (bins, taps) from there."""

    first: np.ndarray
    shares: np.ndarray


class RowShares(NamedTuple):
    """Light of the slices from that of rows: shares (rows, slices), and first and end row per slice (slices, 2)."""

    shares: np.ndarray
    span: np.ndarray


def spread_of(beam: Beam) -> PixelSpread:
    """The light of a beam's pixel. Sharp light uses finer bins; a single row is uniform along z."""
    column, row = beam.sigma, 0.0 if beam.flat else beam.sigma
    return PixelSpread(sqrt(beam.fill), column, row, 3 if column >= 0.4 else 5 if column >= 0.2 else 8)


def column_shares(spread: PixelSpread, beam: Beam, rays: Rays) -> ColumnShares:
    """Mean light of every bin: a pixel's profile there, times the power that rays there bring to the resin."""
    # Light is assumed to change linearly between the middles of bins; this adds three times the variance of a bin to
    # that of the profile, and the Gaussian is narrowed by it beforehand.
    columns, bins = beam.pixels[0], spread.bins
    edge = np.arange(-spread.beyond * bins, (columns + spread.beyond) * bins + 1) / bins  # 0 at the first column's edge
    sigma = sqrt(max(spread.column**2 - 1.0 / (4.0 * bins**2), 0.0))
    taps = min(columns, 2 * ceil(0.5 * spread.side + TAIL * sigma + 1.0 / bins) + 1)
    first = np.clip(np.floor(edge[:-1] + 0.5 / bins).astype(int) - taps // 2, 0, columns - taps)
    column = first[:, None] + np.arange(taps) + 0.5
    shares = _mean(edge[:-1, None] - column, edge[1:, None] - column, spread.side, sigma)
    return ColumnShares(first, shares * _transmitted(rays, (edge - 0.5 * columns) * beam.pitch)[:, None])


def _transmitted(rays: Rays, edge: np.ndarray) -> np.ndarray:
    """Mean transmittance between edges [mm]; 0 beyond the last rays."""
    pieces = 0.5 * (rays.transmittance[1:] + rays.transmittance[:-1]) * np.diff(rays.u)
    total = np.concatenate([[0.0], np.cumsum(pieces)])
    return np.diff(np.interp(edge, rays.u, total)) / np.diff(edge)


def row_shares(spread: PixelSpread, beam: Beam, z: np.ndarray, height: float, multiple: int) -> RowShares:
    """Mean light of slices ``height`` [mm] high about ``z`` [mm], from that of rows; padded to full slices."""
    rows = beam.pixels[1]
    center = z / beam.pitch + 0.5 * (rows - 1)
    half, side = 0.5 * height / beam.pitch, 1.0 if beam.flat else spread.side
    reach = half + 0.5 * side + TAIL * spread.row
    row = np.arange(rows)[:, None]
    shares = np.zeros((rows, -(-z.size // multiple) * multiple))
    shares[:, : z.size] = np.where(
        np.abs(row - center) <= reach, _mean(center - half - row, center + half - row, side, spread.row), 0.0
    )
    span = np.stack([np.ceil(center - reach), np.floor(center + reach) + 1], axis=1)
    span = np.clip(span, 0, rows).astype(int)
    return RowShares(shares, np.pad(span, ((0, shares.shape[1] - z.size), (0, 0)), "edge"))


def _mean(low: np.ndarray, high: np.ndarray, side: float, sigma: float) -> np.ndarray:
    """Mean, between two positions, of a box of area 1 about 0, ``side`` wide, blurred by a Gaussian."""
    half = 0.5 * side
    gained = _ramp(high + half, sigma) - _ramp(high - half, sigma) - _ramp(low + half, sigma) + _ramp(low - half, sigma)
    return gained / ((high - low) * side)


def _ramp(x: np.ndarray, sigma: float) -> np.ndarray:
    """Second integral of a Gaussian, that is, max(x, 0) blurred by it."""
    if sigma == 0:
        return np.maximum(x, 0.0)
    from scipy.special import ndtr  # takes longer to load than all of vamgpu

    return x * ndtr(x / sigma) + sigma / sqrt(2.0 * np.pi) * np.exp(-0.5 * (x / sigma) ** 2)

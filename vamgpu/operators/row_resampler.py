"""Resampling between the rows of a beam and the slices of a grid: two samplings of z about the same middle."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import sqrt

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.geometry import Beam
from vamgpu.kernels.footprint import FAR, TAIL, THINNEST
from vamgpu.kernels.resample import resample

Empty = Callable[[tuple[int, ...]], DeviceArray]
"""Function that makes a field of a shape."""


class RowResampler:
    """Resamples light of rows of pixels to slices of voxels and back; each direction is the transpose of the other."""

    # A weight is the light of a row, averaged over a slice: of its lit box (``fill`` of its height), blurred by the
    # point spread ``sigma`` [rows]. raised: distance by which the light is higher [rows]. gap: height between the lower
    # half of the slices and the upper one [mm].

    def __init__(
        self, rows: int, row_pitch: float, slices: int, slice_pitch: float, device: Device, fill: float = 1.0,
        sigma: float = 0.0, raised: float = 0.0, gap: float = 0.0,
    ) -> None:  # fmt: skip
        self.rows: int = rows
        self.slices: int = slices
        self.device: Device = device
        ratio = slice_pitch / row_pitch
        self.same_pitch: bool = abs(ratio - 1.0) < 1e-6
        self.same: bool = rows == slices and self.same_pitch and fill == 1.0 and sigma == raised == gap == 0.0
        """Whether each row is a slice."""
        self.weights: np.ndarray = np.eye(rows)
        """Share of the light of each row in each slice, (slices, rows)."""
        if self.same:
            return
        middle = np.arange(slices) - 0.5 * (slices - 1)
        position = middle * ratio + np.sign(middle) * 0.5 * gap / row_pitch + 0.5 * (rows - 1) - raised
        matrix = ratio * mean_light(position[:, None] - np.arange(rows), ratio, fill, sigma)
        self.weights = matrix
        self._to_slices, self._from_slices = (banded(device, m) for m in (matrix, matrix.T))

    @classmethod
    def of(
        cls, beam: Beam, slices: int, pitch: float, device: Device, height: float = 0.0, gap: float = 0.0
    ) -> RowResampler:
        """The resampler of a beam for slices of a pitch [mm], with light raised by ``height`` [mm]."""
        fill, sigma = (1.0, 0.0) if beam.flat else (sqrt(beam.fill), beam.sigma)
        return cls(beam.pixels[1], beam.pitch, slices, pitch, device, fill, sigma, height / beam.pitch, gap)

    def in_slices(self, rows: DeviceArray, empty: Empty | None = None) -> DeviceArray:
        """The light [angle, r, slice] of rows; the rows themselves if each is a slice."""
        if self.same:
            return rows
        slices = (empty or self.device.empty)((*rows.shape[:2], self.slices))
        self.to_slices(rows, slices)
        return slices

    @contextmanager
    def filling(self, rows: DeviceArray, empty: Empty | None = None) -> Iterator[DeviceArray]:
        """A field [angle, r, slice] to fill and resample to rows; the rows themselves if each is a slice."""
        slices = rows if self.same else (empty or self.device.empty)((*rows.shape[:2], self.slices))
        yield slices
        if slices is not rows:
            self.from_slices(slices, rows)

    def from_slices(self, source: DeviceArray, target: DeviceArray) -> None:
        """target [pose, r, row] from source [pose, r, slice]."""
        self.device.launch(resample, source=source, lanes=source, target=target, **self._from_slices)

    def to_slices(self, source: DeviceArray, target: DeviceArray) -> None:
        """target [pose, r, slice] from source [pose, r, row]."""
        self.device.launch(resample, source=source, lanes=source, target=target, **self._to_slices)


def mean_light(distance: np.ndarray, height: float | np.ndarray, fill: float, sigma: float) -> np.ndarray:
    """Mean over a slice ``height`` rows high of the light of a row at a distance [rows]; sums to 1 over rows."""
    distance, height = np.broadcast_arrays(distance, height)
    inside = np.abs(distance) < np.maximum(0.5 * (height + fill) + TAIL * sigma, FAR * sigma)
    distance, height, mean = distance[inside], height[inside], np.zeros(inside.shape)
    outer, inner = 0.5 * (height + fill), 0.5 * np.abs(height - fill)
    ends = sum(_second_integral(distance + x, sigma) for x in (outer, -outer))
    middle = sum(_second_integral(distance + x, sigma) for x in (inner, -inner))
    mean[inside] = np.maximum(ends - middle, 0.0) / (height * fill)
    return mean


def _second_integral(x: np.ndarray, sigma: float) -> np.ndarray:
    """Second integral from −∞ of a Gaussian of standard deviation ``sigma`` about 0; x₊ for none."""
    if sigma < 1e-3 * THINNEST:
        return np.maximum(x, 0.0)
    from scipy.special import ndtr

    t = x / sigma
    return x * ndtr(t) + sigma / np.sqrt(2.0 * np.pi) * np.exp(-0.5 * t**2)


def banded(device: Device, matrix: np.ndarray) -> dict[str, DeviceArray]:
    """The tables of `resample` for a matrix [target, source] whose rows are one short run each."""
    filled = matrix != 0.0
    first = np.maximum.accumulate(filled.argmax(axis=1))  # a row without an entry begins where the previous one does
    last = np.where(filled.any(axis=1), matrix.shape[1] - filled[:, ::-1].argmax(axis=1), first + 1)
    taps = np.arange(int((last - first).max()))
    columns = np.minimum(first[:, None] + taps, matrix.shape[1] - 1)
    weights = np.take_along_axis(matrix, columns, axis=1) * (first[:, None] + taps < last[:, None])
    return {"first": device.table(first, "int32"), "weights": device.table(weights)}

"""Rows of a beam and slices of a grid: two samplings of z about the same middle."""

from __future__ import annotations

from dataclasses import dataclass

from vamgpu.backend.array import DeviceArray
from vamgpu.kernels.resample import resample
from vamgpu.operators.light import EQUAL


@dataclass(frozen=True)
class Rows:
    """How light of ``rows`` of ``row_pitch`` [mm] falls on ``slices`` of ``slice_pitch``; both ways are transposes."""

    rows: int
    row_pitch: float
    slices: int
    slice_pitch: float

    @property
    def same(self) -> bool:
        """Whether each row is a slice."""
        return self.rows == self.slices and self.same_pitch

    @property
    def same_pitch(self) -> bool:
        """Whether a row is as high as a slice."""
        return abs(self._ratio - 1.0) < 1e-6

    @property
    def _ratio(self) -> float:
        return self.slice_pitch / self.row_pitch

    def from_slices(self, source: DeviceArray, target: DeviceArray) -> None:
        """target [pose, r, row] from source [pose, r, slice]."""
        self._resample(source, target, 1.0 / self._ratio, row=1.0 / self._ratio)

    def to_slices(self, source: DeviceArray, target: DeviceArray) -> None:
        """target [pose, r, slice] from source [pose, r, row]."""
        self._resample(source, target, self._ratio, row=1.0)

    def _resample(self, source: DeviceArray, target: DeviceArray, ratio: float, row: float) -> None:
        """A row being ``row`` samples of the source high: what a slice and a row overlap."""
        width = 1.0 if self._ratio <= EQUAL else self._ratio  # of a slice, in rows
        target.device.launch(
            resample,
            source=source,
            ratio=ratio,
            reach=0.5 * (1.0 + width) * row,
            most=row,
            gain=self._ratio / (width * row),
            lanes=source.lanes,
            target=target,
        )

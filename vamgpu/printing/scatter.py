"""Automatic exposure: the light goes off when the resin scatters as much as a calibrated print does."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from vamgpu.errors import BadInput
from vamgpu.geometry import positive

STOP = 0.35  # gray levels per voxel at which the paper stops; 0.15 to 0.35 are acceptable there


@dataclass(frozen=True)
class ScatterReading:
    """One camera frame."""

    seconds: float  # when it was taken
    density: float  # gray levels per voxel of the part above the first frame
    stop: bool  # whether the light should be off by now


@dataclass
class ScatterStop:
    """Scatter density S(t) = ΣI(t)/V − ΣI(0)/V of camera frames, and the time when it reaches a threshold.

    Eq. 1 of the automatic exposure paper. V counts voxels of the part; a threshold therefore holds for one voxel size
    and one camera. voxels: V, the sum of a target's fractions. threshold: [gray levels/voxel]. steady: number of
    consecutive frames that must reach it, to ignore a flash. The first frame is the background, taken before the light
    goes on; its scatter (dust, dark counts, used resin) is subtracted. Raises `BadInput`.
    """

    voxels: float
    threshold: float = STOP
    steady: int = 1
    readings: list[ScatterReading] = field(default_factory=list, init=False)
    _background: float = field(default=0.0, init=False)
    _shape: tuple[int, ...] = field(default=(), init=False)

    def __post_init__(self) -> None:
        positive("voxels of the part", self.voxels)
        positive("threshold [gray levels/voxel]", self.threshold)
        if isinstance(self.steady, bool) or not isinstance(self.steady, int) or self.steady < 1:
            raise BadInput(f"steady is {self.steady!r}; expected at least 1 frame")

    def see(self, seconds: float, image: npt.NDArray[np.generic]) -> ScatterReading:
        """Add one frame [row, column] in gray levels; the first is taken before the light. Raises `BadInput`."""
        if image.ndim != 2 or (self._shape and image.shape != self._shape):
            raise BadInput(f"a frame has shape {image.shape}; expected {self._shape or '[row, column]'}, as for others")
        total = float(image.sum(dtype=np.float64))
        if not np.isfinite(total):
            raise BadInput("a frame holds values that are not finite; expected gray levels")
        if self.readings and seconds <= self.readings[-1].seconds:
            raise BadInput(f"a frame at {seconds:g} s follows {self.readings[-1].seconds:g} s; expected rising times")
        if not self.readings:
            self._background, self._shape = total, image.shape
        density = (total - self._background) / self.voxels
        reached = [*(r.density for r in self.readings[-self.steady :]), density][-self.steady :]
        stopped = bool(self.readings) and self.readings[-1].stop
        stop = stopped or (len(reached) == self.steady and min(reached) >= self.threshold)
        self.readings.append(ScatterReading(float(seconds), density, stop))
        return self.readings[-1]

    @property
    def stopped(self) -> float | None:
        """Time [s] of the frame at which the light should go off; None before."""
        return next((reading.seconds for reading in self.readings if reading.stop), None)

    @property
    def crossing(self) -> float | None:
        """Time [s] at which the density passed the threshold before the stop, linear between frames; None before."""
        if self.stopped is None:
            return None
        last = next(k for k, reading in enumerate(self.readings) if reading.stop) - self.steady + 1
        if last == 0:
            return self.readings[0].seconds
        before, after = self.readings[last - 1], self.readings[last]
        share = (self.threshold - before.density) / (after.density - before.density)
        return before.seconds + share * (after.seconds - before.seconds)

    def watch(self, frames: Iterable[tuple[float, npt.NDArray[np.generic]]]) -> float | None:
        """Add (seconds, image) until the stop, and return its time; None if the frames end first."""
        for seconds, image in frames:
            if self.see(seconds, image).stop:
                break
        return self.stopped

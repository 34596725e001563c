"""Light of every angle over a print: times that differ, and frames that follow a part or miss it."""

from __future__ import annotations

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.geometry import Beam, Turntable
from vamgpu.kernels.dwell import weigh_poses
from vamgpu.operators.compose import combine
from vamgpu.operators.follow import followed
from vamgpu.operators.shifts import Shift
from vamgpu.operators.web_motion import WebMotion


class Dwell:
    """Weights images [angle, r, z], tile after tile, by their angle's time over the mean; moves them with the part."""

    # A = D·M·P: P has the rows of light of every angle, M the moves of the part, D the times. `weigh` follows P, and
    # `weighted` precedes Pᵀ.

    def __init__(self, motion: Turntable | WebMotion, beam: Beam, device: Device) -> None:
        self._device = device
        times, self._shift = np.ones(1), None
        if isinstance(motion, Turntable):
            times = times if motion.dwell is None else motion.times
            if (path := followed(motion, beam)) is not None:
                times = motion.times * path.repeats / len(path.whole)
                steps, shares = zip(*path.in_steps(1, 1), strict=True)
                moves = np.repeat(np.array(steps, float), motion.angles, axis=0)
                self._shift = Shift(device, moves, beam.pixels, beam.pixels)
                self._shares = device.table(np.concatenate(shares) * np.ones((1, beam.pixels[1])))
        self._times = None if (times == 1.0).all() else device.table(times)

    def weigh(self, images: DeviceArray) -> None:
        """The transpose of `weighted`, in place."""
        if self._shift is not None:
            copy = combine(1.0, images, 0.0, images, self._device.empty(images.shape))
            self._shift.there(copy, self._shares, images)
        if self._times is not None:
            self._device.launch(weigh_poses, light=images, times=self._times, weighted=images)

    def sent(self, images: DeviceArray) -> DeviceArray:
        """images · times in new memory, or the images themselves if all angles are lit equally long."""
        if self._times is None:
            return images
        out = self._device.empty(images.shape)
        self._device.launch(weigh_poses, light=images, times=self._times, weighted=out)
        return out

    def weighted(self, images: DeviceArray) -> DeviceArray:
        """The light of a print in the part at rest: `sent`, moved, and averaged over the turns."""
        images = self.sent(images)
        if self._shift is None:
            return images
        out = self._device.empty(images.shape)
        self._shift.back(images, self._shares, out)
        return out

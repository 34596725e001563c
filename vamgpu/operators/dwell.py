"""Angles that are lit for unequal times: part of every operator with a turntable."""

from __future__ import annotations

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.geometry import Turntable
from vamgpu.kernels.dwell import weigh_poses
from vamgpu.operators.web_motion import WebMotion


class Dwell:
    """Weights images [angle, r, z], of tile after tile, by the ratio of the time of their angle to the mean."""

    # A = D·P: P has the rows of light of every angle, D the times. `weigh` follows P, and `weighted` precedes Pᵀ.

    def __init__(self, motion: Turntable | WebMotion, device: Device) -> None:
        self._device = device
        times = motion.times if isinstance(motion, Turntable) and motion.dwell is not None else None
        self._times = None if times is None else device.table(times)

    def weigh(self, images: DeviceArray) -> None:
        """images *= times, in place."""
        if self._times is not None:
            self._device.launch(weigh_poses, light=images, times=self._times, weighted=images)

    def weighted(self, images: DeviceArray) -> DeviceArray:
        """images · times in new memory, or the images themselves if all angles are lit equally long."""
        if self._times is None:
            return images
        out = self._device.empty(images.shape)
        self._device.launch(weigh_poses, light=images, times=self._times, weighted=out)
        return out

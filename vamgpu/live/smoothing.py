"""Means over the neighborhood of voxels."""

from __future__ import annotations

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.kernels.blur import blur_slices
from vamgpu.kernels.filter import filter_rows
from vamgpu.kernels.gauss import blur_planes
from vamgpu.kernels.update import multiply
from vamgpu.operators.compose import NO_FLOOR

REACH = 4.0  # standard deviations beyond which neighbors do not count


class Smoothing:
    """Gaussian means over voxels on a device; at the faces of the grid, over the existing voxels. sigma: [voxels]."""

    def __init__(self, device: Device, shape: tuple[int, int, int], sigma: float) -> None:
        reach = np.arange(int(REACH * sigma + 0.5) + 1)
        taps = np.exp(-0.5 * (reach / sigma) ** 2)
        taps /= 2.0 * taps.sum() - taps[0]
        both = np.concatenate([taps[:0:-1], taps])
        x, y, z = (np.convolve(np.ones(n), both)[reach[-1] : reach[-1] + n] for n in shape)
        self._device, self._taps = device, device.table(taps)
        self._share = device.upload(1.0 / (x[:, None, None] * y[:, None] * z))

    def __call__(self, field: DeviceArray) -> DeviceArray:
        """The means of a field [x, y, z]."""
        launch, taps = self._device.launch, self._taps
        first, second = (self._device.empty(field.shape) for _ in range(2))
        launch(blur_planes, source=field, taps=taps, blurred=first)
        launch(filter_rows, sinogram=first, taps=taps, stride=1, floor=NO_FLOOR, filtered=second)
        launch(blur_slices, source=second, taps=taps, blurred=first)
        launch(multiply, x=first, y=self._share, out=first)
        return first

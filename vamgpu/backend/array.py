"""A value living on a device."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from vamgpu.backend.device import Device


@dataclass(eq=False)
class DeviceArray:
    """An array on a device: a field ``[major, minor, z]`` in lane layout (``lanes`` > 0) or a plain table (0).

    shape: logical shape, padding not counted.  handle: what the device's own library calls it.
    """

    device: Device
    handle: Any
    shape: tuple[int, ...]
    dtype: np.dtype
    lanes: int

    @property
    def nbytes(self) -> int:
        """Bytes on the device, padding included."""
        return self.device.stored_bytes(self.shape, self.dtype, self.lanes)

    def numpy(self, out: np.ndarray | None = None) -> np.ndarray:
        """A NumPy copy of the logical array; that of a table may go to ``out``."""
        return self.device.download(self, out)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        array = self.numpy()
        return array if dtype is None else array.astype(dtype)

    def __repr__(self) -> str:
        return f"DeviceArray(shape={self.shape}, dtype={self.dtype}, device={self.device.name})"

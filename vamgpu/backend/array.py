"""A value living on a device."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from vamgpu.backend.device import Device


@dataclass(eq=False)
class DeviceArray:
    """An array on a device: a field [major, minor, z] in lane layout (``lanes`` > 0) or a plain table (0).

    Attributes:
        device: The device that holds it.
        handle: The object of the device's own library.
        shape: Logical shape, without padding.
        dtype: NumPy type of the elements.
        lanes: Number of slices z that are adjacent in memory.
        owner: Object that owns the memory and must outlive the array; None if the array owns it.
    """

    device: Device
    handle: Any
    shape: tuple[int, ...]
    dtype: np.dtype
    lanes: int
    owner: Any = None

    @property
    def nbytes(self) -> int:
        """Bytes on the device, padding included."""
        return self.device.stored_bytes(self.shape, self.dtype, self.lanes)

    def numpy(self, out: np.ndarray | None = None) -> np.ndarray:
        """Copy the logical array to NumPy.

        Args:
            out: Array for the copy of a table, [shape]; None for a new array.

        Returns:
            The copy, [shape].
        """
        return self.device.download(self, out)

    def part(self, first: int, last: int) -> np.ndarray:
        """Copy entries of the first axis to NumPy, for arrays too large for a second copy in memory.

        Args:
            first: The first entry.
            last: The one after the last.

        Returns:
            The copy, [last - first, *shape[1:]].
        """
        return self.device.part(self, first, last)

    def native(self) -> Any:
        """The array as an object of the device's own library, in logical shape and C order.

        It shares memory with this one, or is a copy on the device if this one is in slabs; therefore only read it, and
        write to an array of your own.

        Returns:
            (*shape,): a `numpy.ndarray`, `warp.array` or `pyopencl.array.Array`.
        """
        return self.device.native(self)

    def __dlpack__(
        self, *, stream: Any = None, max_version: Any = None, dl_device: Any = None, copy: bool | None = None
    ) -> Any:
        return self.device.export(self, stream, max_version, dl_device, copy)

    def __dlpack_device__(self) -> tuple[int, int]:
        return self.device.dlpack_device

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        array = self.numpy()
        return array if dtype is None else array.astype(dtype)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle values and device; copies then have their own memory."""
        return self.device.restored, (self.numpy(), not self.lanes)

    def __repr__(self) -> str:
        return f"DeviceArray(shape={self.shape}, dtype={self.dtype}, device={self.device.name})"

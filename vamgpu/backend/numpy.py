"""The reference device: NumPy in float64, plain layout; it runs the definitions of the kernels."""

from __future__ import annotations

from math import prod
from typing import Any

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.backend.host_memory import from_host
from vamgpu.errors import OutOfMemory
from vamgpu.kernels.signature import Kernel

ALIGNED = 64  # alignment of arrays in bytes: JAX copies arrays with another alignment


class NumpyDevice(Device):
    """Runs the NumPy definitions; slow, exact, always available."""

    def __init__(self) -> None:
        super().__init__("numpy", "NumPy, float64 reference")

    @property
    def real(self) -> np.dtype:
        return np.dtype(np.float64)

    def lanes_for(self, nz: int) -> int:
        return 0

    def _allocate(self, shape: tuple[int, ...], dtype: np.dtype, lanes: int) -> np.ndarray:
        try:
            memory = np.empty(prod(shape) * dtype.itemsize + ALIGNED, np.uint8)
        except MemoryError as error:
            raise OutOfMemory(f"no memory for {shape} of {dtype}; use a coarser grid") from error
        begin = -memory.ctypes.data % ALIGNED
        return memory[begin : begin + memory.size - ALIGNED].view(dtype).reshape(shape)

    def _write(self, handle: np.ndarray, stored: np.ndarray, first: int = 0) -> None:
        handle.reshape(-1)[first : first + stored.size] = stored.reshape(-1)

    def _read(self, handle: np.ndarray, stored: np.ndarray, first: int = 0) -> None:
        stored.reshape(-1)[...] = handle.reshape(-1)[first : first + stored.size]

    def _offer(self, handle: np.ndarray, taker: Device) -> np.ndarray | None:
        return handle if isinstance(taker, NumpyDevice) else None

    def _take(self, handle: np.ndarray, giver: Device, offer: np.ndarray) -> None:
        handle[...] = offer

    def _launch(self, kernel: Kernel, bound: dict[str, Any], sizes: dict[str, int], lanes: int) -> None:
        kernel.definition(**bound)

    def items(self, kernel: Kernel, shape: tuple[int, int, int]) -> int:
        return 1

    def synchronize(self) -> None:
        pass

    def adopt(self, foreign: Any) -> DeviceArray:
        array = from_host(self, foreign)
        return DeviceArray(self, array, array.shape, array.dtype, 0)

    def _native(self, table: DeviceArray) -> np.ndarray:
        return table.handle

    def _exported(self, table: DeviceArray, copy: bool) -> np.ndarray:
        return table.handle.copy() if copy else table.handle

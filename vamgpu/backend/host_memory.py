"""Arrays of other libraries in host memory, as NumPy arrays."""

from __future__ import annotations

from typing import Any

import numpy as np

from vamgpu.errors import DeviceError


def from_host(device: object, foreign: Any) -> np.ndarray:
    """A C contiguous NumPy array from host memory; a copy if that is strided or read-only. Raises `DeviceError`."""
    array = foreign if isinstance(foreign, np.ndarray) else from_dlpack(device, foreign)
    return np.require(array, requirements=["C", "W"])


def from_dlpack(device: object, foreign: Any) -> np.ndarray:
    """The NumPy array for an object in host memory that supports DLPack. Raises `DeviceError`."""
    try:
        return np.from_dlpack(foreign)
    except (AttributeError, TypeError, RuntimeError, ValueError, BufferError) as error:
        raise DeviceError(
            f"{device} adopts arrays in host memory that support DLPack; got {type(foreign).__name__} ({error}): "
            "upload a NumPy copy instead"
        ) from error


def fetched(foreign: Any) -> np.ndarray | None:
    """A copy by ``__array__``, also for types that DLPack lacks; None if there is none, or a library refuses."""
    try:
        return np.asarray(foreign) if hasattr(foreign, "__array__") else None
    except (TypeError, ValueError, RuntimeError):
        return None


def to_read(array: np.ndarray) -> np.ndarray:
    """The same memory for devices to read, even if it is read-only: JAX's arrays never change, but may be shared."""
    if array.flags.writeable or not array.flags.c_contiguous or not array.size:
        return array
    return np.asarray(_Memory(array))


class _Memory:
    """Memory of a read-only array as writable memory; keeps the array alive."""

    def __init__(self, array: np.ndarray) -> None:
        self.array = array

    @property
    def __array_interface__(self) -> dict[str, Any]:
        given = self.array.__array_interface__
        return given | {"data": (given["data"][0], False)}

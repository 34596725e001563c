"""Arrays of other libraries in host memory, as NumPy arrays."""

from __future__ import annotations

from typing import Any

import numpy as np

from vamgpu.errors import DeviceError


def from_host(device: object, foreign: Any) -> np.ndarray:
    """A C contiguous NumPy array from host memory; a copy where that is strided or read-only. Raises `DeviceError`."""
    array = foreign if isinstance(foreign, np.ndarray) else from_dlpack(device, foreign)
    return np.require(array, requirements=["C", "W"])


def from_dlpack(device: object, foreign: Any) -> np.ndarray:
    """The NumPy array of what lies in host memory and speaks DLPack. Raises `DeviceError`."""
    try:
        return np.from_dlpack(foreign)
    except (AttributeError, TypeError, RuntimeError, ValueError, BufferError) as error:
        raise DeviceError(
            f"{device} adopts arrays in host memory that speak DLPack; got {type(foreign).__name__} ({error}): "
            "upload a NumPy copy instead"
        ) from error


def fetched(foreign: Any) -> np.ndarray | None:
    """A copy by ``__array__``, also of types that DLPack has not; None if there is none, or a library refuses."""
    try:
        return np.asarray(foreign) if hasattr(foreign, "__array__") else None
    except (TypeError, ValueError, RuntimeError):
        return None


def to_read(array: np.ndarray) -> np.ndarray:
    """The same memory for devices to read, also where it is read-only: JAX's arrays never change, but may be shared."""
    if array.flags.writeable or not array.flags.c_contiguous or not array.size:
        return array
    return np.asarray(_Memory(array))


class _Memory:
    """Memory of a read-only array, without the ban; keeps it alive."""

    def __init__(self, array: np.ndarray) -> None:
        self.array = array

    @property
    def __array_interface__(self) -> dict[str, Any]:
        given = self.array.__array_interface__
        return given | {"data": (given["data"][0], False)}

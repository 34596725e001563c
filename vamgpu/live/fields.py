"""Operations on whole fields, on the device that holds them."""

from __future__ import annotations

from typing import Any

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.kernels.resample import resample
from vamgpu.kernels.update import fill_background
from vamgpu.kernels.watch import pick_voxels
from vamgpu.operators.compose import combine
from vamgpu.operators.reductions import EVERYWHERE, extent
from vamgpu.operators.row_resampler import banded


def here(device: Device, values: Any) -> DeviceArray:
    """Values [i, j, z] as a field on a device; they pass through the host only if they are on another device."""
    away = isinstance(values, DeviceArray) and values.device is not device
    return device.field(values.numpy() if away else values)


def scaled(field: DeviceArray, factor: float, offset: float = 0.0) -> DeviceArray:
    """A new field: offset + factor·field."""
    out, ends = field.device.empty(field.shape), {"low": offset, "high": offset + factor}
    field.device.launch(fill_background, target=field, **ends, reach=EVERYWHERE, model=out)
    return out


def added(first: DeviceArray, *others: DeviceArray, factor: float = 1.0) -> DeviceArray:
    """A new field: first + factor·(sum of the others), all on one device."""
    out = combine(1.0, first, 0.0, first, first.device.empty(first.shape))
    for other in others:
        combine(1.0, out, factor, other, out)
    return out


def lowered(field: DeviceArray, down: float) -> DeviceArray:
    """A field moved down by slices, linearly between them; its top continues upwards."""
    if not down:
        return field
    count, out = field.shape[2], field.device.empty(field.shape)
    source = np.clip(np.arange(count) + down, 0, count - 1)
    weights = np.maximum(1.0 - np.abs(source[:, None] - np.arange(count)), 0.0)
    field.device.launch(resample, source=field, lanes=field, **banded(field.device, weights), target=out)
    return out


def alike(first: DeviceArray, second: DeviceArray) -> bool:
    """Whether two fields of one device hold the same finite numbers."""
    off = combine(1.0, first, -1.0, second, first.device.empty(first.shape))
    return extent(off) == (0.0, 0.0)


def places(device: Device, numbers: np.ndarray, shape: tuple[int, ...]) -> DeviceArray:
    """A table (count, 3) of the indices of voxels, given by their numbers in C order; for `picked`."""
    return device.table(np.stack(np.unravel_index(numbers, shape), axis=1), "int32")


def picked(field: DeviceArray, places: DeviceArray) -> np.ndarray:
    """Values of the voxels of `places`, float64 (count,); nothing else leaves the device."""
    device, count = field.device, places.shape[0]
    found = device.empty((count,), device.kept("float32"), table=True)  # type: ignore[arg-type]
    device.launch(pick_voxels, field=field, places=places, picked=found)
    return found.numpy().astype(float)

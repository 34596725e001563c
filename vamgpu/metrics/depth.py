"""Signed depth of voxels' centers below the surface of a part, on a device, only from the fractions of the voxels."""

from __future__ import annotations

from itertools import cycle
from math import ceil

import numpy as np
import numpy.typing as npt

from vamgpu.backend import open_device
from vamgpu.backend.array import DeviceArray
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.geometry import positive
from vamgpu.kernels.depth import FARTHEST, cut_voxels, nearest_cut, signed_depths

Array = npt.NDArray[np.float32]

LARGEST_REACH = FARTHEST + 1  # number of voxels that a search may span
TOGETHER, FEWEST = 1 << 26, 32  # number of voxels that a device measures at a time, and least number of slices


def surrounded(fraction: Array, by: int, flat: bool = False) -> Array:
    """Fractions with a border of this many voxels: copies of the ends above and below a flat part, else empty."""
    beside = np.pad(fraction, ((by, by), (by, by), (0, 0) if flat else (by, by)))
    return np.pad(beside, ((0, 0), (0, 0), (by, by)), mode="edge") if flat else beside


def padded_depth(fraction: Array, reach: float, flat: bool, device: Device | None = None) -> tuple[Array, int]:
    """Depths [voxels] that are right up to ``reach``, with the border of voxels that this needs; and its width."""
    pad = ceil(reach) + 2
    return signed_depth(surrounded(fraction, pad, flat), reach + 0.5, device), pad


def signed_depth(fraction: npt.ArrayLike, reach: float, device: Device | None = None) -> Array:
    """Distance of every voxel's center from the surface of a part, positive in the part, on the host."""
    # fraction [x, y, z], unknown beyond the array: pad it with zeros; reach [voxels], at most 12; returns [voxels]
    values, place = np.asarray(fraction), open_device(device)
    if values.ndim != 3 or not values.size:
        raise BadInput(f"the fractions have shape {values.shape}; expected [x, y, z] with at least one voxel")
    depth, halo, last = np.empty(values.shape, np.float32), _span(reach) + 1, values.shape[2]
    places = getattr(place, "members", (place,))  # slabs need no more of each other than their halos
    each = min(max(TOGETHER // (values.shape[0] * values.shape[1]), FEWEST), ceil(last / len(places)))
    for first, own in zip(range(0, last, each), cycle(places)):  # noqa: B905 - members take turns
        low, end = max(first - halo, 0), min(first + each, last)
        part = own.upload(values[:, :, low : end + halo])
        depth[:, :, first:end] = depth_field(part, reach, first - low, end - first).numpy()
    return depth


def depth_field(fraction: DeviceArray, reach: float, first: int, slices: int, pitch: float = 1.0) -> DeviceArray:
    """Signed depths [pitch] of some slices of fractions [x, y, z], which need ``reach`` + 2 more on either side."""
    device, span, shape = fraction.device, _span(reach), fraction.shape
    place, *steps = (device.empty(shape) for _ in range(3))
    device.launch(cut_voxels, fraction=fraction, place=place, steps=steps[0])
    for axis in range(3):
        device.launch(nearest_cut, steps=steps[0], axis=axis, span=span, nearest=steps[1])
        steps.reverse()
    depth = steps[1] if slices == shape[2] else device.empty((*shape[:2], slices))
    given = {"fraction": fraction, "place": place, "steps": steps[0], "lanes": fraction}
    device.launch(signed_depths, **given, first=first, reach=reach, pitch=pitch, depth=depth)
    return depth


def _span(reach: float) -> int:
    """Number of voxels along an axis to the farthest surface that matters."""
    span = ceil(positive("reach [voxels]", reach)) + 1
    if span > FARTHEST:
        raise BadInput(f"reach is {reach:g} voxels; expected at most {FARTHEST - 1}: judge finer voxels in steps")
    return span

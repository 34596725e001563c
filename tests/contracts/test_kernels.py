"""Every declared kernel on every device against its NumPy definition, from the examples that the profiler times."""

from __future__ import annotations

from functools import cache, lru_cache
from typing import Any

import kernel_examples as examples
import numpy as np
import pyopencl as cl
import pytest

import vamgpu
from vamgpu.backend.device import Device
from vamgpu.backend.opencl import OpenclDevice
from vamgpu.kernels.catalog import kernels
from vamgpu.kernels.signature import Kernel, Scalar
from vamgpu.kernels.stack import put_slices

FENCE, MARK = 4096, 0x5A
COUNTS = 1e-3
"""Share of counts and levels that may differ: a value on the edge of two bins falls to either."""


@lru_cache(maxsize=2)  # devices come one after the other
def reference(kernel: Kernel, size: int) -> examples.Bound:
    bound = examples.bind(vamgpu.open_device("numpy"), kernel, size)
    bound.launch()
    return bound


def test_every_kernel_has_an_example() -> None:
    assert not examples.missing()


FOLDED = ("forward_footprint", "back_footprint")
"""Kernels that fold 68 poses and voxels by symmetry."""


def agrees(any_device: Device, kernel: Kernel, size: int) -> None:
    """Nor does an item that fills up a group write anywhere else."""
    device = fenced(any_device)
    bound = examples.bind(device, kernel, size)
    bound.launch()
    assert not isinstance(device, FencedDevice) or device.unharmed()
    counts = any(a.dtype.kind in "iu" for n, a in bound.arguments.items() if getattr(kernel.arguments[n], "writes", 0))
    assert bound.error(reference(kernel, size)) <= (COUNTS if counts else 1e-5)
    if isinstance(device, FencedDevice):
        device.forget()


# 4 slices are one thread's work on a GPU, 13 several's, 68 several slabs'
@pytest.mark.every_device
@pytest.mark.parametrize("kernel", kernels(), ids=lambda kernel: kernel.name)
def test_devices_agree_with_the_definition(fast_device: Device, kernel: Kernel) -> None:
    agrees(fast_device, kernel, 25)


@pytest.mark.parametrize("kernel", [one for one in kernels() if one.name in FOLDED], ids=lambda kernel: kernel.name)
def test_devices_agree_where_poses_are_folded(fast_device: Device, kernel: Kernel) -> None:
    agrees(fast_device, kernel, 68)


@pytest.mark.slow
@pytest.mark.parametrize("size", [7, 68])
@pytest.mark.parametrize("kernel", kernels(), ids=lambda kernel: kernel.name)
def test_devices_agree_at_other_sizes(fast_device: Device, kernel: Kernel, size: int) -> None:
    agrees(fast_device, kernel, size)


@pytest.mark.parametrize("kernel", kernels(), ids=lambda kernel: kernel.name)
def test_a_kernel_updates_what_it_says(kernel: Kernel) -> None:
    """What stands in a written array beforehand matters where it is said to be updated, and nowhere else."""
    for name, spec in kernel.arguments.items():
        if isinstance(spec, Scalar) or not spec.writes:
            continue
        runs = []
        for more in (0, 1):
            bound = examples.bind(vamgpu.open_device("numpy"), kernel, 7)
            bound.arguments[name].handle[...] += bound.arguments[name].dtype.type(more)
            before = bound.arguments[name].numpy()
            bound.launch()
            runs.append({n: a.numpy() for n, a in bound.arguments.items() if getattr(kernel.arguments[n], "writes", 0)})
            runs[-1]["kept"] = runs[-1][name] == before
        one, other = runs
        kept = one.pop("kept") & other.pop("kept")
        apart = {n: ~np.isclose(one[n], other[n], rtol=1e-9, atol=0.0, equal_nan=True) for n in one}
        apart[name] &= ~kept
        assert any(different.any() for different in apart.values()) == spec.updates, name


def test_slices_are_taken_from_the_middle_of_a_field(fast_device: Device) -> None:
    values = np.arange(3 * 4 * 9, dtype=np.float32).reshape(3, 4, 9)
    source, some = fast_device.upload(values), fast_device.upload(np.zeros((3, 4, 5), np.float32))
    fast_device.launch(put_slices, source=source, first=-2, factor=1.0, keep=0, lanes=source, stack=some)
    assert np.array_equal(some.numpy(), values[:, :, 2:7])


class FencedDevice(OpenclDevice):
    """An OpenCL device whose arrays are followed by a strip nobody may write to."""

    def __init__(self, like: OpenclDevice) -> None:
        super().__init__(f"{like.name}, fenced", like.context)
        self.is_gpu = like.is_gpu
        self.fenced: list[tuple[cl.Buffer, int]] = []

    def _allocate(self, shape: tuple[int, ...], dtype: np.dtype, lanes: int) -> cl.Buffer:
        nbytes = int(np.prod(shape, dtype=np.int64)) * dtype.itemsize
        buffer = cl.Buffer(self.context, cl.mem_flags.READ_WRITE, nbytes + FENCE)
        cl.enqueue_copy(self.queue, buffer, np.full(FENCE, MARK, np.uint8), dst_offset=nbytes)
        self.fenced.append((buffer, nbytes))
        return buffer

    def unharmed(self) -> bool:
        """Whether every fence still stands."""
        strip: Any = np.empty(FENCE, np.uint8)
        for buffer, nbytes in self.fenced:
            cl.enqueue_copy(self.queue, strip, buffer, src_offset=nbytes)
            if (strip != MARK).any():
                return False
        self.fenced.clear()
        return True

    def _built(self, kernel: Kernel, options: list[str], cached: bool) -> cl.Program:
        """A GPU's layout, in which no processor computes, takes longer to optimize than to launch once."""
        stands = self.is_gpu and self._device.type & cl.device_type.CPU
        return super()._built(kernel, [*options, *(["-cl-opt-disable"] if stands else [])], cached)

    def forget(self) -> None:
        """Free compiled kernels, which take megabytes each, and which no other test asks this device for."""
        self._compiled.cache_clear()
        self._planned.cache_clear()


@cache
def fenced(device: Device) -> Device:
    """An OpenCL device with fences; any other as it is."""
    return FencedDevice(device) if isinstance(device, OpenclDevice) else device

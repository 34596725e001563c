"""Buffers of the ring: where they lie, that devices read into them, and that nothing of them stays behind."""

from __future__ import annotations

import gc
import mmap
import weakref
from typing import Any

import numpy as np
import pyopencl as cl
import pytest

from vamgpu.backend.device import Device
from vamgpu.backend.opencl import OpenclDevice
from vamgpu.hosts.frames.buffers import PinnedBuffers, pinned_buffers

SHAPE = (3, 8, 5, 16)


def wanted(device: Device) -> str:
    """Where memory for a device should come from."""
    if getattr(getattr(device, "_device", None), "is_cuda", False):
        return "warp"
    return "opencl" if getattr(device, "is_gpu", False) else "pages"


def maps_of(owner: Any) -> int:
    return owner.get_info(cl.mem_info.MAP_COUNT)


def test_memory_is_locked_for_a_gpu_and_whole_pages_otherwise(device: Device) -> None:
    with pinned_buffers(2, SHAPE, device) as made:
        kind = wanted(device)
        assert made.locked == (kind != "pages") and len(made) == 2
        for array, owner in zip(made, made.owners, strict=True):
            assert array.shape == SHAPE and array.dtype == np.uint8 and not array.any()
            assert array.flags.c_contiguous and array.flags.writeable
            if kind == "warp":
                assert owner.pinned and owner.ptr == array.ctypes.data
            elif kind == "opencl":
                assert owner.flags & cl.mem_flags.ALLOC_HOST_PTR and maps_of(owner) == 1
            else:
                assert array.ctypes.data % mmap.PAGESIZE == 0


def test_a_device_reads_into_them_again_and_again(device: Device) -> None:
    levels = np.arange(np.prod(SHAPE), dtype=np.uint8).reshape(SHAPE)
    table = device.upload(levels, table=True)
    with pinned_buffers(2, SHAPE, device) as made:
        addresses = [array.ctypes.data for array in made]
        for array in (*made, *made):
            array[...] = 0
            assert table.numpy(array) is array and np.array_equal(array, levels)
        assert [array.ctypes.data for array in made] == addresses
        assert np.array_equal(device.upload(made[1], table=True).numpy(), levels)


def test_memory_goes_with_the_last_view(device: Device) -> None:
    made = pinned_buffers(1, SHAPE, device)
    kind, owner = wanted(device), made.owners[0]
    view = made[0][1:, :2]
    made.close()
    made.close()
    assert not len(made)
    gc.collect()
    view[...] = 7  # closed, but somebody still looks
    assert (view == 7).all()
    if kind == "opencl":
        assert maps_of(owner) == 1
        del view
        gc.collect()
        assert isinstance(device, OpenclDevice)
        device.synchronize()
        assert maps_of(owner) == 0
    else:
        gone = weakref.ref(owner)
        del owner
        gc.collect()
        assert gone() is not None
        del view
        gc.collect()
        assert gone() is None


def test_opencl_buffers_are_freed_after_they_are_unmapped(opencl_device: Device) -> None:
    made = pinned_buffers(1, SHAPE, opencl_device)
    if not made.locked:
        assert isinstance(made.owners[0], mmap.mmap)
        return
    kept: Any = made.owners[0]
    before = kept.reference_count
    made.close()
    gc.collect()
    opencl_device.synchronize()
    assert before > kept.reference_count == 1 and maps_of(kept) == 0  # the last reference is ours


@pytest.mark.parametrize("count", [0, 3])
def test_without_a_device_they_are_pages(count: int) -> None:
    made = pinned_buffers(count, (2, 3))
    assert isinstance(made, PinnedBuffers) and not made.locked
    assert len({array.ctypes.data for array in made}) == count
    assert made[1:] == tuple(made)[1:]

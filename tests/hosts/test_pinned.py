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
from vamgpu.hosts.frames.buffers import pinned_buffers

SHAPE = (3, 8, 5, 16)


def wanted(device: Device) -> str:
    """Where memory for a device should come from."""
    if getattr(getattr(device, "_device", None), "is_cuda", False):
        return "warp"
    return "opencl" if getattr(device, "is_gpu", False) else "pages"


def maps_of(owner: Any) -> int:
    return owner.get_info(cl.mem_info.MAP_COUNT)


def owner_of(array: np.ndarray) -> Any:
    """The memory that an array looks at: a mapped file, or an array or a map of a driver."""
    found: Any = array
    while isinstance(found, (np.ndarray, memoryview)):
        found = found.obj if isinstance(found, memoryview) else found.base
    return found


def test_memory_is_locked_for_a_gpu_and_whole_pages_otherwise(device: Device) -> None:
    made = pinned_buffers(2, SHAPE, device)
    kind = wanted(device)
    assert len(made) == 2
    for array in made:
        assert array.shape == SHAPE and array.dtype == np.uint8 and not array.any()
        assert array.flags.c_contiguous and array.flags.writeable
        owner = owner_of(array)
        if kind == "warp":
            assert owner.pinned and owner.ptr == array.ctypes.data
        elif kind == "pages":
            assert isinstance(owner, mmap.mmap) and array.ctypes.data % mmap.PAGESIZE == 0


def test_a_device_reads_into_them_again_and_again(device: Device) -> None:
    levels = np.arange(np.prod(SHAPE), dtype=np.uint8).reshape(SHAPE)
    table = device.upload(levels, table=True)
    made = pinned_buffers(2, SHAPE, device)
    addresses = [array.ctypes.data for array in made]
    for array in (*made, *made):
        array[...] = 0
        assert table.numpy(array) is array and np.array_equal(array, levels)
    assert [array.ctypes.data for array in made] == addresses
    assert np.array_equal(device.upload(made[1], table=True).numpy(), levels)


def test_memory_goes_with_the_last_view(device: Device) -> None:
    made = pinned_buffers(1, SHAPE, None if wanted(device) == "opencl" else device)
    gone, view = weakref.ref(owner_of(made[0])), made[0][1:, :2]
    del made
    gc.collect()
    view[...] = 7  # let go of, but somebody still looks
    assert (view == 7).all() and gone() is not None
    del view
    gc.collect()
    assert gone() is None


def test_opencl_buffers_are_unmapped_with_the_last_view(opencl_device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    real, owners = cl.Buffer, list[Any]()
    monkeypatch.setattr(opencl_device, "is_gpu", True)
    monkeypatch.setattr(cl, "Buffer", lambda *given: owners.append(real(*given)) or owners[-1])
    view = pinned_buffers(1, SHAPE, opencl_device)[0][1:, :2]
    (owner,) = owners
    gc.collect()
    view[...] = 7
    assert (view == 7).all() and owner.flags & cl.mem_flags.ALLOC_HOST_PTR and maps_of(owner) == 1
    del view
    gc.collect()
    opencl_device.synchronize()
    assert maps_of(owner) == 0


@pytest.mark.parametrize("count", [0, 3])
def test_without_a_device_they_are_pages(count: int) -> None:
    made = pinned_buffers(count, (2, 3))
    assert len({array.ctypes.data for array in made}) == count

"""Fields go in and out as arrays of other libraries, shared where the layout allows, else copied on the device."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyopencl.array as cla
import pytest
import warp as wp
from needs import missing

from vamgpu.backend.device import Device
from vamgpu.backend.opencl import OpenclDevice
from vamgpu.errors import BadInput, DeviceError
from vamgpu.geometry import Beam, Grid, Turntable
from vamgpu.operators.projection import Projection

SHAPES = [(5, 3, 16), (4, 5, 32), (3, 4, 7), (2, 3, 70)]


def values_of(shape: tuple[int, ...]) -> np.ndarray:
    return np.random.default_rng(1).random(shape).astype(np.float32)


def foreign(device: Device, values: np.ndarray) -> Any:
    """The values in an array of the device's own library."""
    if isinstance(device, OpenclDevice):
        return cla.to_device(device.queue, values)
    return values if device.name == "numpy" else wp.array(values, device=device.name.partition(":")[2])


def fetched(theirs: Any) -> np.ndarray:
    fetch = getattr(theirs, "get", None) or getattr(theirs, "numpy", None)
    return fetch() if fetch else theirs


@pytest.mark.parametrize("shape", SHAPES)
def test_fields_of_every_depth_go_in_and_out(device: Device, shape: tuple[int, int, int]) -> None:
    values = values_of(shape)
    theirs = foreign(device, values)
    with device.no_transfers():
        field = device.field(device.adopt(theirs))
        again, native = device.field(device.plain(field)), field.native()
    assert field.lanes == again.lanes == device.lanes_for(shape[2])
    for array in (field, again):
        assert np.array_equal(array.numpy(), values)
    assert type(native).__module__.partition(".")[0] == type(theirs).__module__.partition(".")[0]
    assert np.array_equal(fetched(native), values)
    for array in (field, device.adopt(theirs)):
        assert np.array_equal(np.from_dlpack(array, device="cpu"), values)  # type: ignore[call-overload]


def test_an_operator_takes_arrays_of_other_libraries(device: Device) -> None:
    A = Projection(Grid((6, 6, 5), 1.0), Beam((8, 5), 1.0), Turntable(4), device=device)
    x = values_of(A.domain.shape)
    wanted, theirs = A(x), foreign(device, x)
    for operand in (device.adopt(theirs), theirs) if device.name != "numpy" else (device.adopt(x),):
        found = A(operand)
        assert not isinstance(found, np.ndarray)
        assert np.array_equal(found.numpy(), wanted)
    assert A(x.astype(np.float16)).dtype == np.float16
    with pytest.raises(BadInput, match="float16"):
        A(np.full(A.domain.shape, 60000, np.float16))


def test_what_fills_one_slab_shares_memory(device: Device) -> None:
    values = values_of((3, 4, 16 if isinstance(device, OpenclDevice) and not device.is_gpu else 32))
    theirs = foreign(device, values.astype(device.real))
    field = device.field(device.adopt(theirs))
    device.launch(_scaling(), a=2.0, x=field, b=0.0, y=field, floor=0.0, out=field)
    device.synchronize()
    assert np.array_equal(fetched(theirs), 2.0 * values)
    if not device.is_gpu:
        before, view = np.from_dlpack(field, copy=True), np.from_dlpack(field, copy=False)
        device.launch(_scaling(), a=2.0, x=field, b=0.0, y=field, floor=0.0, out=field)
        device.synchronize()
        assert np.array_equal(before, 2.0 * values) and np.array_equal(view, 4.0 * values)


def _scaling() -> Any:
    from vamgpu.kernels.update import linear

    return linear


def test_a_copy_that_is_forbidden_is_refused(fast_device: Device) -> None:
    with pytest.raises(BufferError, match="copy"):
        np.from_dlpack(fast_device.upload(values_of((2, 3, 70))), copy=False)
    with pytest.raises(BufferError, match="exports to"):
        fast_device.upload(values_of((2, 3, 4))).__dlpack__(dl_device=(10, 0))


def test_host_arrays_are_shared_with_processors(device: Device) -> None:
    if device.is_gpu:
        return
    table = values_of((3, 5))[::2].astype(device.real)  # strided: copied
    assert np.array_equal(device.adopt(table).numpy(), table)
    with pytest.raises(DeviceError, match="adopt"):
        device.adopt("light")


def test_doubles_are_cast_on_processors_and_refused_on_gpus(fast_device: Device) -> None:
    values = np.random.default_rng(0).random((2, 3, 4))
    if fast_device.name.startswith("warp"):
        with pytest.raises(DeviceError, match="float64"):
            fast_device.adopt(foreign(fast_device, values))
        return
    theirs = fast_device.adopt(foreign(fast_device, values))
    if fast_device.is_gpu:
        with pytest.raises(BadInput, match="float64"):
            fast_device.field(theirs)
    else:
        assert np.array_equal(fast_device.field(theirs).numpy(), values.astype(np.float32))


def jax_array(device: Device, values: np.ndarray) -> Any:
    """The values as an array of JAX in host memory, of the device's type."""
    try:
        import jax
    except ImportError:
        missing("install JAX: pip install vamgpu[jax]")
    jax.config.update("jax_enable_x64", True)
    return jax.device_put(values.astype(device.real), jax.devices("cpu")[0])


def address(array: Any) -> int:
    return np.from_dlpack(array).__array_interface__["data"][0]


def test_arrays_of_jax_go_in_and_out_without_a_copy(device: Device) -> None:
    jax = pytest.importorskip("jax")

    values = values_of((3, 4, 16 if isinstance(device, OpenclDevice) and not device.is_gpu else 32))
    theirs = jax_array(device, values)
    if device.is_gpu:
        assert np.array_equal(device.field(theirs).numpy(), values)
        return
    with device.no_transfers():
        field = device.field(theirs)
        back = jax.dlpack.from_dlpack(field)
    assert address(field) == theirs.unsafe_buffer_pointer() == back.unsafe_buffer_pointer()
    own = device.upload(values)
    assert jax.dlpack.from_dlpack(own).unsafe_buffer_pointer() == address(own)
    del theirs, back
    assert np.array_equal(field.numpy(), values)  # which keeps the memory


def test_arrays_of_jax_in_another_layout_or_type_are_copied(device: Device) -> None:
    jax = pytest.importorskip("jax")

    for shape in ((2, 3, 7), (2, 3, 70)):
        theirs = jax_array(device, values_of(shape))
        for given in (theirs, theirs.transpose(1, 0, 2), theirs.astype(np.float32), theirs > 0.5):
            field = device.field(given)
            assert np.allclose(field.numpy(), np.asarray(given)) and np.allclose(
                jax.dlpack.from_dlpack(field), np.asarray(given)
            )
    with pytest.raises((BadInput, DeviceError), match="bfloat16|adopts"):
        device.field(theirs.astype("bfloat16"))

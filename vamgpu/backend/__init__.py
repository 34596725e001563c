"""Devices: where kernels run, found by name.

``numpy`` · ``opencl:<platform>:<index>`` · ``warp:cpu`` · ``warp:cuda:<index>``. The default is NVIDIA's
OpenCL, else Warp on CUDA, else another OpenCL GPU, else OpenCL on the CPU, else Warp on the CPU, else NumPy.

Several devices can divide the slices of every field: ``warp:cuda:*`` uses all CUDA devices,
``warp:cuda:0+warp:cuda:2`` these two. ``gpu`` and ``cpu`` are the best of their kind; a part of a name, such as
``cuda``, ``cuda:1`` or ``intel``, is the best device that it matches. ``opencl:pocl:0@8GB`` limits the memory of fields
to 8 GB and keeps further fields in files, in the folder that TMPDIR names or in ``/var/tmp``.
"""

from __future__ import annotations

import ctypes
import importlib.util
from collections.abc import Iterator
from functools import cache
from itertools import chain
from typing import TYPE_CHECKING

from vamgpu.backend.array import DeviceArray
from vamgpu.errors import BadInput, DeviceError
from vamgpu.quantity import bytes_of

if TYPE_CHECKING:
    from vamgpu.backend.device import Device

__all__ = ["DeviceArray", "default_device", "devices", "open_device", "within"]

BESIDE = 1_000_000_000
"""Bytes of private memory that a job needs in addition to its fields; the largest measured value was 0.9 GB."""


@cache
def devices() -> tuple[str, ...]:
    """Names of all working devices, best first; an OpenCL device counts if it has run a kernel."""
    warp = ["warp:cpu"] if importlib.util.find_spec("warp") else []
    working = (name for name in (*_gpus(), *_opencl_names()[1]) if name.startswith("warp") or _opencl_works(name))
    return (*working, *warp, "numpy")


@cache
def default_device() -> str:
    """Name of the best device; stops at the first that works."""
    names = chain(_gpus(), _opencl_names()[1])
    return next((name for name in names if name.startswith("warp") or _opencl_works(name)), None) or devices()[0]


def _gpus() -> Iterator[str]:
    """GPUs, best first: on NVIDIA's, projections on rings are four times as fast in OpenCL as in Warp."""
    nvidia = [name for name in _opencl_names()[0] if name.startswith("opencl:nvidia")]
    yield from nvidia
    yield from _cuda_names()
    yield from (name for name in _opencl_names()[0] if name not in nvidia)


def open_device(name: str | Device | None = None) -> Device:
    """Open the device of that name; each is opened once.

    Args:
        name: A name that `devices` lists; a part of one such as ``cuda``, or ``gpu`` or ``cpu``, for the best match;
            several joined by ``+``; all with a common prefix, as in ``warp:cuda:*``; an open device; or None for the
            default. Upper or lower case does not matter.

    Returns:
        The device.

    Raises:
        DeviceError: There is no such device (the message names those that exist), or it cannot keep fields in files.
    """
    if name is None:
        name = default_device()
    if isinstance(name, str):
        return _open(name)
    from vamgpu.backend.device import Device  # avoids a circular import: devices unpickle by `open_device`

    if not isinstance(name, Device):
        raise DeviceError(
            f"got {name!r} for a device; expected a name, one of {', '.join(devices())}, or an open device"
        )
    return name


def within(device: str | None, memory: str) -> str:
    """Name of a device whose fields keep a process within a limit of private memory.

    Args:
        device: A processor through OpenCL, by name; None takes the best one.
        memory: Memory of the process, such as ``8GB``; `BESIDE` of it is reserved for everything except fields.

    Returns:
        The name, such as ``opencl:pocl:0@7000000000B``.

    Raises:
        BadInput: The memory is not a size, or too small; or there is no such processor.
    """
    size = bytes_of(memory)
    if size is None or size <= BESIDE:
        raise BadInput(f"got {memory!r} of memory; expected more than {BESIDE / 1e9:g} GB, such as 8GB")
    if device is None:
        device = next((name for name in devices() if name in _opencl_names()[1]), None)
        if device is None:
            raise BadInput("fields in files need an OpenCL processor, and none works here; `vam doctor` says why")
    return f"{device.partition('@')[0]}@{size - BESIDE}B"


@cache
def _open(name: str) -> Device:
    name, limited, size = name.partition("@")
    memory = bytes_of(size)
    if (full := _full(name)) != name:
        return _open(full + limited + size)
    kind, _, rest = name.partition(":")
    if limited and (memory is None or name not in _opencl_names()[1]):
        raise DeviceError(
            f"{name}@{size} is not a device; expected an OpenCL processor, one of "
            f"{', '.join(_opencl_names()[1]) or 'none here'}, with a size of memory, as in opencl:pocl:0@8GB"
        )
    if name.endswith(":*") or "+" in name:
        from vamgpu.backend.slabs import SlabDevice  # PyOpenCL and Warp below are imported only when needed

        found = [each for each in devices() if each.startswith(name[:-1])] if name.endswith(":*") else name.split("+")
        if found:
            return SlabDevice(name, _members(found))
    if name == "numpy":
        from vamgpu.backend.numpy import NumpyDevice

        return NumpyDevice()
    if kind == "opencl" and name in (*_opencl_names()[0], *_opencl_names()[1]) and _opencl_works(name):
        from vamgpu.backend.opencl import OpenclDevice
        from vamgpu.backend.opencl_platforms import context_of

        return OpenclDevice(name + limited + size, context_of(name), memory)
    if kind == "warp" and (rest == "cpu" or name in _cuda_names()) and importlib.util.find_spec("warp"):
        from vamgpu.backend.warp import WarpDevice

        return WarpDevice(name, rest)
    raise DeviceError(f"no device {name!r}; available: {', '.join(devices())} (`vam doctor` says why others are not)")


def _members(names: list[str]) -> list[Device]:
    """Devices that share slices; GPUs of one platform share a context."""
    if importlib.util.find_spec("pyopencl") and all(name.startswith("opencl:") for name in names):
        from vamgpu.backend.opencl import OpenclDevice
        from vamgpu.backend.opencl_platforms import shared_context

        if (context := shared_context(names)) is not None:
            found = {name: OpenclDevice(name, context) for name in names}
            return [found[name] for name in names]
    return [open_device(name) for name in names]


def _full(name: str) -> str:
    """The name of the best device that ``gpu``, ``cpu`` or a part of its name matches; else the name itself."""
    name = name.lower()
    in_full = name in ("numpy", "warp:cpu") or (name.startswith(("opencl:", "warp:")) and not name[-1].isalpha())
    if in_full or "+" in name or not name[:1].isalpha():
        return name
    kinds = {"gpu": tuple(_gpus()), "cpu": (*_opencl_names()[1], "warp:cpu", "numpy")}
    alike = kinds.get(name) or [each for each in devices() if f":{name}:" in f":{each}:"]
    return next((each for each in devices() if each in alike), name)


def _has_cuda_driver() -> bool:
    """Whether NVIDIA's driver can be loaded; Warp takes a second to start and complains if it cannot."""
    for library in ("libcuda.so.1", "nvcuda.dll"):
        try:
            ctypes.CDLL(library)
        except OSError:
            continue
        return True
    return False


@cache
def _cuda_names() -> tuple[str, ...]:
    if importlib.util.find_spec("warp") is None or not _has_cuda_driver():
        return ()
    import warp as wp

    from vamgpu.backend.warp import start

    start()
    return tuple(f"warp:{device.alias}" for device in wp.get_cuda_devices())


@cache
def _opencl_names() -> tuple[tuple[str, ...], tuple[str, ...]]:
    """GPUs and processors that OpenCL lists, working or not."""
    if importlib.util.find_spec("pyopencl") is None:
        return (), ()
    import pyopencl as cl

    from vamgpu.backend.opencl_platforms import all_devices

    found = all_devices()
    gpus = tuple(name for name, device in found.items() if device.type & cl.device_type.GPU)
    return gpus, tuple(name for name in found if name not in gpus)


@cache
def _opencl_works(name: str) -> bool:
    from vamgpu.backend.opencl_platforms import complaint

    return complaint(name) is None

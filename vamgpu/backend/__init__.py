"""Devices: where kernels run, found by name.

``numpy`` · ``opencl:<platform>:<index>`` · ``warp:cpu`` · ``warp:cuda:<index>``. The default is Warp on CUDA, else an
OpenCL GPU, else OpenCL on the CPU, else Warp on the CPU, else NumPy.
"""

from __future__ import annotations

import importlib.util
from functools import lru_cache
from typing import TYPE_CHECKING

from vamgpu.backend.array import DeviceArray
from vamgpu.errors import DeviceError

if TYPE_CHECKING:
    from vamgpu.backend.device import Device

__all__ = ["DeviceArray", "default_device", "devices", "open_device"]


@lru_cache(maxsize=1)
def devices() -> tuple[str, ...]:
    """Names of every device that works here, best first; an OpenCL device counts once it has run a kernel."""
    cuda, cpu = _warp_names()
    clever = _opencl_names()
    gpus = [name for name, is_gpu in clever if is_gpu]
    rest = [name for name, is_gpu in clever if not is_gpu]
    return (*cuda, *gpus, *rest, *cpu, "numpy")


def default_device() -> str:
    """Name of the best device here."""
    return devices()[0]


@lru_cache(maxsize=None)
def _open(name: str) -> Device:
    kind, _, rest = name.partition(":")
    if name == "numpy":
        from vamgpu.backend.numpy import NumpyDevice

        return NumpyDevice()
    if kind == "opencl":
        from vamgpu.backend.opencl import OpenclDevice
        from vamgpu.backend.opencl_platforms import all_devices

        return OpenclDevice(name, all_devices()[name])
    from vamgpu.backend.warp import WarpDevice

    return WarpDevice(name, rest)


def open_device(name: str | Device | None = None) -> Device:
    """The device of that name, opened once; None opens the default. Raises `DeviceError` naming what there is."""
    if name is None:
        name = default_device()
    if not isinstance(name, str):
        return name
    if name not in devices():
        raise DeviceError(f"no device {name!r}; here there are: {', '.join(devices())} (`vam doctor` says why)")
    return _open(name)


def _warp_names() -> tuple[list[str], list[str]]:
    if importlib.util.find_spec("warp") is None:
        return [], []
    import warp as wp

    from vamgpu.backend.warp import quiet

    try:
        quiet()
    except RuntimeError:
        return [], []
    return [f"warp:{device.alias}" for device in wp.get_cuda_devices()], ["warp:cpu"]


def _opencl_names() -> list[tuple[str, bool]]:
    if importlib.util.find_spec("pyopencl") is None:
        return []
    import pyopencl as cl

    from vamgpu.backend.opencl_platforms import all_devices, complaint

    found = all_devices().items()
    return [(name, bool(device.type & cl.device_type.GPU)) for name, device in found if complaint(device) is None]

"""The list of devices that tests run on: every one that works here, and every kind that is missing."""

from __future__ import annotations

from functools import cache, lru_cache
from importlib import metadata

import pytest
from needs import missing

import vamgpu
from vamgpu.backend.device import Device

KINDS = {
    "opencl": "no OpenCL device works here: install the package with [cpu], or a driver such as pocl-opencl-icd",
    "opencl:intel": "Intel's OpenCL wheel is installed but offers no working device",
    "warp:cpu": "Warp does not work here: pip install warp-lang",
}
"""Beginning of a device name → why a machine must have one."""

GPU_LAYOUT = " in GPU layout"
"""Ending of the name of an OpenCL processor that is treated as a GPU: four lanes an item, and work-groups."""


def _wanted() -> list[str]:
    try:
        metadata.distribution("intel-opencl-rt")
    except metadata.PackageNotFoundError:
        return [kind for kind in KINDS if kind != "opencl:intel"]
    return list(KINDS)


@lru_cache(maxsize=1)
def device_list() -> tuple[str, ...]:
    """Working devices, a GPU's layout on a processor, and each kind that is missing, see `needs`."""
    working = vamgpu.devices()
    missing = (kind for kind in _wanted() if not any(name.startswith(kind) for name in working))
    clever = sorted((name for name in working if name.startswith("opencl")), key=lambda name: "pocl" not in name)
    return (*working, *(f"{name}{GPU_LAYOUT}" for name in clever[:1]), *missing)


@cache
def open_any(name: str) -> Device:
    """The device of that name in the list; skips or fails the test that asks for a missing kind."""
    if name in KINDS and name not in vamgpu.devices():
        missing(KINDS[name])
    if not name.endswith(GPU_LAYOUT):
        return vamgpu.open_device(name)
    from vamgpu.backend.opencl import OpenclDevice
    from vamgpu.backend.opencl_platforms import context_of

    device = OpenclDevice(name, context_of(name.removesuffix(GPU_LAYOUT)))
    device.is_gpu = True
    return device


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Run a test once for every device, by the name of the fixture it asks for."""
    choices = {
        "device": device_list(),
        "fast_device": [name for name in device_list() if name != "numpy"],
        "opencl_device": [name for name in device_list() if name.startswith("opencl")],
        "opencl_name": [name for name in device_list() if name.startswith("opencl") and GPU_LAYOUT not in name],
    }
    for fixture, names in choices.items():
        if fixture in metafunc.fixturenames:
            metafunc.parametrize(fixture, names, indirect=True)


@pytest.fixture
def device(request: pytest.FixtureRequest) -> Device:
    """Every device, the float64 reference included."""
    return open_any(request.param)


@pytest.fixture
def fast_device(request: pytest.FixtureRequest) -> Device:
    """Every device but the reference, for tests at real size."""
    return open_any(request.param)


@pytest.fixture
def is_quick(fast_device: Device) -> bool:
    """Whether real sizes take seconds; neither on Warp's one thread nor in a GPU's layout on a processor."""
    return fast_device.name != "warp:cpu" and not fast_device.name.endswith(GPU_LAYOUT)


@pytest.fixture
def opencl_name(request: pytest.FixtureRequest) -> str:
    """Name of every OpenCL device."""
    return open_any(request.param).name


@pytest.fixture
def opencl_device(request: pytest.FixtureRequest) -> Device:
    """Every OpenCL device, a GPU's layout included."""
    return open_any(request.param)

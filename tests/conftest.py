"""The list of devices that tests run on: every one that works here, and a failure for every kind that is missing."""

from __future__ import annotations

from functools import lru_cache
from importlib import metadata

import pytest

import vamgpu
from vamgpu.backend.device import Device

KINDS = {
    "opencl": "no OpenCL device works here: install the package with [cpu], or a driver such as pocl-opencl-icd",
    "opencl:intel": "Intel's OpenCL wheel is installed but offers no working device",
    "warp:cpu": "Warp does not work here: pip install warp-lang",
}
"""Beginning of a device name → why a machine must have one."""


def _wanted() -> list[str]:
    try:
        metadata.distribution("intel-opencl-rt")
    except metadata.PackageNotFoundError:
        return [kind for kind in KINDS if kind != "opencl:intel"]
    return list(KINDS)


@lru_cache(maxsize=1)
def device_list() -> tuple[str, ...]:
    """Working devices and, for each kind that is missing, the kind: a test that asks for it fails."""
    working = vamgpu.devices()
    return (*working, *(kind for kind in _wanted() if not any(name.startswith(kind) for name in working)))


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Run a test once for every device, by the name of the fixture it asks for."""
    choices = {
        "device": device_list(),
        "fast_device": [name for name in device_list() if name != "numpy"],
        "opencl_name": [name for name in device_list() if name.startswith("opencl")],
    }
    for fixture, names in choices.items():
        if fixture in metafunc.fixturenames:
            metafunc.parametrize(fixture, names, indirect=True)


def _present(name: str) -> str:
    if name in KINDS and name not in vamgpu.devices():
        pytest.fail(KINDS[name])
    return name


@pytest.fixture
def device(request: pytest.FixtureRequest) -> Device:
    """Every device, the float64 reference included."""
    return vamgpu.open_device(_present(request.param))


@pytest.fixture
def fast_device(request: pytest.FixtureRequest) -> Device:
    """Every device but the reference, for tests at real size."""
    return vamgpu.open_device(_present(request.param))


@pytest.fixture
def opencl_name(request: pytest.FixtureRequest) -> str:
    """Name of every OpenCL device."""
    return _present(request.param)

"""The list of devices that tests run on: every one that works here, and every kind that is missing."""

from __future__ import annotations

import gc
import os
from collections import defaultdict
from collections.abc import Callable, Iterator
from functools import cache, lru_cache, partial
from importlib import metadata
from inspect import isgenerator
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
import pyopencl
import pytest
from hypothesis import settings
from needs import missing

import vamgpu
from vamgpu.backend.device import Device
from vamgpu.kernels import footprint, proof, traced
from vamgpu.targets import shapes

settings.register_profile("same", derandomize=True, deadline=None)  # every run tries the same cases …
settings.register_profile("search", deadline=None)  # … and pytest --hypothesis-profile=search tries new ones
settings.load_profile("same")

KINDS = {
    "opencl": "no OpenCL device works here: install the package with [cpu], or a driver such as pocl-opencl-icd",
    "opencl:intel": "Intel's OpenCL wheel is installed but offers no working device",
    "warp:cpu": "Warp does not work here: pip install warp-lang",
}
"""Beginning of a device name → why a machine must have one."""

WORKER = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0")[2:])
"""Number of this process among those that share the tests."""
MANY = 6
"""Cases of a contract from which on they share the devices that stand for others."""
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
    """Working devices, a GPU's layout on two processors, and each kind that is missing, see `needs`."""
    working = vamgpu.devices()
    missing = (kind for kind in _wanted() if not any(name.startswith(kind) for name in working))
    return (*working, *(f"{name}{GPU_LAYOUT}" for name in _processors()[:2]), *missing)


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


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup() -> Iterator[None]:
    """pytest changes the environment between phases, while PoCL's threads must not start linkers with it."""
    try:
        return (yield)
    finally:
        _finish()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call() -> Iterator[None]:
    """As for the setup."""
    try:
        return (yield)
    finally:
        _finish()


def _finish() -> None:
    """Wait for what PoCL compiles and runs."""
    for name in device_list():
        if name.startswith("opencl:pocl"):
            open_any(name).synchronize()


def pytest_configure(config: pytest.Config) -> None:
    """Look for devices before there are workers: PoCL's first start fails beside others that build the same files."""
    if not hasattr(config, "workerinput"):
        device_list()


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(collector: pytest.Collector) -> Iterator[None]:
    """Every other worker starts at the end, so that each compiles half of the tests and finds the rest compiled."""
    report: Any = yield
    if isinstance(collector, pytest.Dir) and WORKER % 2:
        report.result.reverse()
    return report


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Workers begin with what may take minutes, and devices that stand for others share the cases of a contract.

    These are the reference, Warp on a processor and a GPU's layout on one. Processors and GPUs meet every case, and so
    do all devices with -m slow.
    """
    items.sort(key=lambda item: (item.get_closest_marker("timeout") is None, item.path))
    shared: Any = defaultdict(lambda: defaultdict(list))
    for item in items:
        if isinstance(item, pytest.Function) and (name := _sharing(item)):
            shared[item.path, item.originalname][item.callspec.id.replace(name, "")].append(item)
    for (_, test), cases in shared.items():
        for case, same in cases.items():
            chosen = crc32(f"{test}{case}".encode()) % len(same)  # the same in any collection
            for item in same[:chosen] + same[chosen + 1 :]:
                if len(cases) >= MANY:
                    item.add_marker(pytest.mark.slow)


def _sharing(item: pytest.Function) -> str:
    """The device of a test, if it shares cases; the contract of kernels meets all but second drivers."""
    given: dict[str, Any] = item.callspec.params if hasattr(item, "callspec") else {}
    name = given.get("device", given.get("fast_device", ""))
    stands = name in ("numpy", "warp:cpu") or name.endswith(GPU_LAYOUT)
    contract = item.path.parent.name == "contracts" and item.path.name != "test_kernels.py"
    return name if stands and contract and not _is_second(name) else ""


def pytest_collection_finish() -> None:
    """What thousands of collected tests consist of is never garbage, and need not be searched for it again."""
    gc.freeze()
    gc.enable()


@pytest.hookimpl(trylast=True)
def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Run each case once for every device, one after the other, by the name of the fixture a test asks for."""
    choices = {
        "device": device_list(),
        "fast_device": [name for name in device_list() if name != "numpy"],
        "opencl_device": [name for name in device_list() if name.startswith("opencl")],
        "opencl_name": (
            opencl := [name for name in device_list() if name.startswith("opencl") and GPU_LAYOUT not in name]
        ),
        "opencl_processor": [name for name in opencl if not vamgpu.open_device(name).is_gpu],
    }
    is_close = _is_close(Path(metafunc.definition.path))
    every_device = metafunc.definition.get_closest_marker("every_device") is not None
    for fixture, names in choices.items():
        if fixture in metafunc.fixturenames:
            met = [name for name in names if _is_met(name, every_device, is_close)]
            late = [_is_second(name) or (fixture == "opencl_device" and GPU_LAYOUT in name) for name in met]
            marked = [pytest.param(n, marks=pytest.mark.slow) if slow else n for n, slow in zip(met, late, strict=True)]
            metafunc.parametrize(fixture, marked, indirect=True)


def _is_met(device: str, every_device: bool, is_close: bool) -> bool:
    """Kernels and operators agree on all devices, by the contracts: other tests meet one processor."""
    if _is_second(device):
        return every_device
    return is_close or every_device or not (device in ("warp:cpu", "numpy") or device.endswith(GPU_LAYOUT))


def _is_second(device: str) -> bool:
    """Whether it is one more driver for processors, which runs each kernel once."""
    return device.removesuffix(GPU_LAYOUT) in _processors()[1:]


def _is_close(file: Path) -> bool:
    """Whether a file's tests are about devices: the contracts, and methods' own kernels."""
    return file.parent.name == "contracts" or file.name == "test_kernels.py"


@lru_cache(maxsize=1)
def _processors() -> tuple[str, ...]:
    from vamgpu.backend.opencl_platforms import context_of

    own = [name for name in vamgpu.devices() if name.startswith("opencl")]
    return tuple(name for name in own if context_of(name).devices[0].type & pyopencl.device_type.CPU)


def remembered(function: Callable[..., Any], most: int = 400) -> Callable[..., Any]:
    """A pure function of numbers and arrays that recalls its results, ``most`` at the most, which nobody may change."""
    results: dict[tuple, Any] = {}

    def recalled(*arguments: Any) -> Any:
        key = tuple((a.shape, a.dtype.str, a.tobytes()) if isinstance(a, np.ndarray) else a for a in arguments)
        if key not in results:
            if len(results) >= most:
                results.clear()
            found = function(*arguments)
            results[key] = found = tuple(found) if isgenerator(found) else found
            for part in (found, *(getattr(found, name, None) for name in ("data", "indices", "indptr"))):
                if isinstance(part, np.ndarray):
                    part.flags.writeable = False
        return results[key]

    return recalled


@pytest.fixture(scope="session", autouse=True)
def shares_of_a_pose_are_found_once() -> Iterator[None]:
    """The reference finds columns and rays in voxels anew at every launch; tests launch it thousands of times."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(footprint, "_matrix", remembered(footprint._matrix))
        patch.setattr(traced, "march", remembered(traced.march, most=32))
        patch.setattr(proof, "spans", remembered(proof.spans, most=2))
        yield


@pytest.fixture(scope="session", autouse=True)
def shapes_are_built_once() -> Iterator[None]:
    """A boat takes longer than to solve a small job of it, and nobody can change a solid."""
    with pytest.MonkeyPatch.context() as patch:
        for name, built in shapes._SHAPES.items():
            patch.setitem(shapes._SHAPES, name, cache(built))
        yield


@pytest.fixture(scope="session", autouse=True)
def proofs_look_at_few_points() -> Iterator[None]:
    """Distances and walls are tested with the judge of surfaces; proofs and pages elsewhere only pass them on."""
    from vamgpu.metrics import thin_regions
    from vamgpu.printing import judgement
    from vamgpu.printing import proof as proofs

    def unjudged(*given: Any) -> thin_regions.Unjudged:
        with pytest.MonkeyPatch.context() as few:
            few.setattr(thin_regions, "_LEAST", 1_000)
            return thin_regions.unjudged(*given)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(judgement, "judge_surface", partial(judgement.judge_surface, samples=1_000))
        patch.setattr(proofs, "unjudged", unjudged)
        yield


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
def opencl_processor(request: pytest.FixtureRequest) -> str:
    """Each processor that OpenCL computes on, by its name."""
    return open_any(request.param).name


@pytest.fixture
def processor() -> str:
    """Name of one OpenCL device in the layout of processors."""
    names = (name for name in device_list() if name.startswith("opencl") and GPU_LAYOUT not in name)
    return next((name for name in names if not open_any(name).is_gpu), None) or missing(KINDS["opencl"])


@pytest.fixture
def opencl_device(request: pytest.FixtureRequest) -> Device:
    """Every OpenCL device, a GPU's layout included."""
    return open_any(request.param)

"""Finding OpenCL platforms, including those in Python wheels, without any setting by the user."""

from __future__ import annotations

import os
import tempfile
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache, lru_cache
from importlib import metadata
from pathlib import Path
from threading import Lock
from typing import Any, cast

import numpy as np

from vamgpu.backend.kernel_cache import writable

SLUGS = {"Portable Computing Language": "pocl", "NVIDIA CUDA": "nvidia", "AMD Accelerated Parallel Processing": "amd"}
_BUILDS = Lock()
NO_CACHE = cast("str", False)  # of PyOpenCL, whose lock stays if its process dies
PROBE = "__kernel void twice(__global float *a) { a[get_global_id(0)] = 2.0f * get_global_id(0); }"


def _wheel_drivers() -> list[Path]:
    """Libraries of the Intel wheel: its own .icd file names a placeholder path, and the loader never finds them."""
    try:
        files = metadata.files("intel-opencl-rt") or []
    except metadata.PackageNotFoundError:
        return []
    found = (Path(str(f.locate())).resolve() for f in files if f.name in ("libintelocl.so", "intelocl64.dll"))
    return [path for path in found if path.exists()]


@lru_cache(maxsize=1)
def platforms() -> tuple[Any, ...]:
    """Every OpenCL platform, including wheel drivers; the environment is restored afterwards."""
    writable()  # PoCL and pyopencl read the path of their caches only once
    import pyopencl as cl

    drivers = _wheel_drivers()
    if "OCL_ICD_VENDORS" in os.environ or not drivers or os.name == "nt":
        return _query(cl)
    # The loader reads the vendors folder only once, at the first query; a folder that exists until then suffices. Child
    # processes must not inherit a variable that names a deleted folder.
    with tempfile.TemporaryDirectory(prefix="vamgpu-icd-") as folder:
        for icd in Path("/etc/OpenCL/vendors").glob("*.icd"):
            (Path(folder) / icd.name).write_bytes(icd.read_bytes())
        for number, library in enumerate(drivers):
            (Path(folder) / f"zz-wheel-{number}.icd").write_text(f"{library}\n")
        os.environ["OCL_ICD_VENDORS"] = folder
        try:
            return _query(cl)
        finally:
            del os.environ["OCL_ICD_VENDORS"]


def _query(cl: Any) -> tuple[Any, ...]:
    try:
        return tuple(cl.get_platforms())
    except cl.Error:  # the loader raises an error if it finds no platform
        return ()


def slug(platform_name: str) -> str:
    """Short name of a platform: pocl, intel, nvidia, …"""
    return SLUGS.get(platform_name) or platform_name.split("(")[0].split()[0].lower()


@lru_cache(maxsize=1)
def all_devices() -> dict[str, Any]:
    """Names ``opencl:<platform>:<index>`` of every device listed by a platform, working or not."""
    found: dict[str, Any] = {}
    for platform in platforms():
        try:
            listed = platform.get_devices()
        except Exception:  # noqa: BLE001, S112 - a broken platform may raise anything; it offers no device
            continue
        for device in listed:
            name = slug(platform.name)
            index = sum(key.startswith(f"opencl:{name}:") for key in found)
            found[f"opencl:{name}:{index}"] = device
    return found


@cache
def context_of(name: str) -> Any:
    """The only context of a named device: PoCL loads its library of built-in functions anew for each context."""
    import pyopencl as cl

    return cl.Context([all_devices()[name]])


def shared_context(names: Sequence[str]) -> Any:
    """A context of several GPUs, whose queues can wait for each other; None if they are not GPUs of one platform."""
    import pyopencl as cl

    found = [all_devices()[name] for name in dict.fromkeys(names) if name in all_devices()]
    gpus = [device for device in found if device.type & cl.device_type.GPU]
    alike = len({device.platform for device in gpus}) == 1 and len(gpus) == len(set(names))
    return cl.Context(gpus) if alike and len(gpus) > 1 else None


@contextmanager
def quiet_build() -> Iterator[None]:
    """Build a program without its compiler's warnings; one at a time, because threads share the filters of warnings."""
    import pyopencl as cl

    with _BUILDS, warnings.catch_warnings():
        warnings.simplefilter("ignore", cl.CompilerWarning)
        yield


def complaint(name: str) -> str | None:
    """Reason why the device of that name cannot build and run a trivial kernel, or None if it can."""
    import pyopencl as cl

    try:
        context, device = context_of(name), all_devices()[name]
        queue = cl.CommandQueue(context, device)
        buffer = cl.Buffer(context, cl.mem_flags.READ_WRITE, 64)
        with quiet_build():
            program = cl.Program(context, PROBE).build(devices=[device], cache_dir=NO_CACHE)
        program.twice(queue, (16,), None, buffer)
        got = np.empty(16, np.float32)
        cl.enqueue_copy(queue, got, buffer)
    except (cl.Error, RuntimeError) as error:  # a driver too old for the processor raises a plain RuntimeError
        return f"{type(error).__name__}: {str(error).strip().splitlines()[0][:160]}"
    expected = 2.0 * np.arange(16, dtype=np.float32)
    return None if (got == expected).all() else f"a trivial kernel returned {got[:4]}…, expected {expected[:4]}…"

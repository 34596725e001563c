"""Why a device works here, or why it does not and what to install.

Drivers may crash or hang; therefore each is examined in a separate process with a time limit.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import dataclass
from typing import Any

from vamgpu.backend.kernel_cache import VARIABLE, refusal, writable
from vamgpu.cli.remedies import for_graphics, for_processor
from vamgpu.errors import VamError

LIMIT = 120.0  # time limit for a driver to list its devices or to run one kernel [s]
TOLERANCE = 1e-5
BREAKS = "a driver crashes its process; remove it or update it"


@dataclass(frozen=True)
class Finding:
    """One device, or one kind of device that is missing. remedy: what to do if it does not work."""

    name: str
    description: str
    works: bool
    remedy: str = ""


def examine(limit: float = LIMIT) -> list[Finding]:
    """Find the devices, run a kernel on each, and list what is missing."""
    listed = _ask(["list"], limit)
    if "error" in listed:
        return [Finding("all devices", listed["error"], False, listed.get("remedy", BREAKS))]
    found = [_probed(name, about, limit) for name, about in listed["devices"].items()]
    return [*found, *(Finding(name, why, False, remedy) for name, why, remedy in listed["missing"])]


def _probed(name: str, about: str, limit: float) -> Finding:
    said = _ask(["probe", name], limit)
    if "error" in said:
        return Finding(name, f"{about}: {said['error']}", False, said.get("remedy") or _repair(name))
    return Finding(name, f"{about}: kernels agree with the reference to {said['deviation']:.0e}", True)


def _repair(name: str) -> str:
    if name.startswith("opencl:intel"):
        return "pip install --upgrade intel-opencl-rt intel-cmplr-lib-rt, or use another device"
    if name.startswith("opencl:pocl"):
        return "update pocl-opencl-icd, or use another device"
    return "update its driver, or choose another device"


def _ask(arguments: list[str], limit: float) -> dict[str, Any]:
    """The answer of a separate process, or the reason why there is none."""
    command = [sys.executable, "-m", "vamgpu.cli.doctor", *arguments]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=limit, check=False)
    except subprocess.TimeoutExpired:
        return {"error": f"no answer within {limit:g} s"}
    lines = done.stdout.strip().splitlines()
    if done.returncode == 0 and lines:
        return json.loads(lines[-1])
    if done.returncode < 0:
        return {"error": f"the driver ended its process with signal {-done.returncode}"}
    said = done.stderr.strip().splitlines()
    return {"error": said[-1] if said else f"exit status {done.returncode}"}


def _list() -> dict[str, Any]:
    found, missing = {"numpy": "float64 reference"}, []
    if writable() is not None:
        remedy = f"set {VARIABLE} to a folder that this user may write"
        missing.append(("cache of kernels", f"{refusal()}: every process must compile its kernels again", remedy))
    for look in (_opencl, _warp):
        more, lacks = look()
        found |= more
        missing += lacks
    return {"devices": found, "missing": missing}


def _opencl() -> tuple[dict[str, str], list[tuple[str, str, str]]]:
    try:
        from vamgpu.backend.opencl_platforms import all_devices, platforms

        names, empty = all_devices(), [p for p in platforms() if not _devices_of(p)]
    except ImportError as error:
        return {}, [("opencl", f"pyopencl does not load: {error}", "pip install pyopencl")]
    import pyopencl as cl

    found = {name: f"{d.name.strip()} ({d.platform.name}, {d.version.strip()})" for name, d in names.items()}
    missing = [(f"opencl:{p.name}", "the platform offers no device", "update or remove its driver") for p in empty]
    kinds = [device.type for device in names.values()]
    if not any(kind & cl.device_type.CPU for kind in kinds):
        remedy = for_processor()
        if vendors := os.environ.get("OCL_ICD_VENDORS"):
            remedy = f"OCL_ICD_VENDORS={vendors} hides all other drivers: unset it, or {remedy}"
        missing.append(("opencl on the processor", "no platform runs kernels on the processor", remedy))
    if not any(kind & cl.device_type.GPU for kind in kinds):
        missing.append(("opencl on a GPU", "no platform offers a graphics processor", for_graphics()))
    return found, missing


def _devices_of(platform: Any) -> list[Any]:
    import pyopencl as cl

    try:
        return list(platform.get_devices())
    except (cl.Error, RuntimeError):
        return []


def _warp() -> tuple[dict[str, str], list[tuple[str, str, str]]]:
    try:
        import warp as wp

        from vamgpu.backend.warp import start

        start()
    except (ImportError, RuntimeError) as error:
        return {}, [("warp", f"Warp does not start: {error}", "pip install --upgrade warp-lang")]
    found = {"warp:cpu": f"Warp {wp.config.version}"}
    cards = {f"warp:{d.alias}": f"{d.name} (Warp {wp.config.version})" for d in wp.get_cuda_devices()}
    lacks = [] if cards else [("warp:cuda", "Warp finds no CUDA device", "needs an NVIDIA GPU and its driver")]
    return found | cards, lacks


def _probe(name: str) -> dict[str, float]:
    """Largest deviation of a projection and its transpose from the reference, over their maxima."""
    import numpy as np

    from vamgpu.backend.numpy import NumpyDevice
    from vamgpu.geometry import Beam, Grid, Turntable
    from vamgpu.operators.projection import Projection

    geometry = (Grid((17, 17, 5), 0.1), Beam((17, 5), 0.1), Turntable(12))
    A, reference = Projection(*geometry, device=_opened(name)), Projection(*geometry, device=NumpyDevice())
    rng = np.random.default_rng(0)
    x, y = rng.random(A.domain.shape), rng.random(A.range.shape)
    pairs = ((A(x), reference(x)), (A.T(y), reference.T(y)))
    deviation = max(float(np.abs(got - expected).max() / expected.max()) for got, expected in pairs)
    if not deviation <= TOLERANCE:
        raise RuntimeError(f"kernels deviate from the reference by {deviation:.1e} of the maximum")
    return {"deviation": deviation}


def _opened(name: str) -> Any:
    """A device by name, without opening any other."""
    kind, _, rest = name.partition(":")
    if kind == "warp":
        from vamgpu.backend.warp import WarpDevice

        return WarpDevice(name, rest)
    if kind == "opencl":
        from vamgpu.backend.opencl import OpenclDevice
        from vamgpu.backend.opencl_platforms import complaint, context_of

        if (why := complaint(name)) is not None:
            raise RuntimeError(why)
        return OpenclDevice(name, context_of(name))
    from vamgpu.backend.numpy import NumpyDevice

    return NumpyDevice()


def answer(arguments: list[str]) -> dict[str, Any]:
    """Answer of the child process."""
    try:
        return _list() if arguments[0] == "list" else _probe(arguments[1])
    except VamError as error:  # its message contains the remedy
        problem, _, remedy = str(error).rpartition("; ")
        return {"error": problem, "remedy": remedy}


if __name__ == "__main__":
    sys.stdout.write(json.dumps(answer(sys.argv[1:])) + "\n")

"""What the profiling scripts share: the machine, timing, peers in their own environment, records, and the Benchy."""

from __future__ import annotations

import importlib.metadata
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

HERE = Path(__file__).resolve().parent
PACKAGES = ("vamgpu", "numpy", "pyopencl", "warp-lang", "intel-opencl-rt", "scipy")
MESH = HERE.parent.parent / "shared" / "data" / "benchy.stl"
"""Where the Benchy is looked for unless told otherwise; it is not part of the project."""
FILL = 0.95
"""Radius of the part over half the width of the grid, as in the scripts of the peers."""


def machine(*devices: Any) -> dict[str, Any]:
    """Processor, load, versions, the commit, and what the devices say of themselves."""
    from vamgpu.jobs.bench import machine as describe

    return {
        **describe(),
        "usable_cores": len(os.sched_getaffinity(0)),
        "load_1min": round(os.getloadavg()[0], 2),
        "gpu": _output("nvidia-smi", "--query-gpu=name,driver_version", "--format=csv,noheader"),
        "packages": {name: _version(name) for name in PACKAGES},
        "commit": _output("git", "-C", str(HERE), "describe", "--always", "--dirty"),
        "devices": {device.name: device.description for device in devices},
        "when": time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime()),
    }


def _version(name: str) -> str | None:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None


def _output(*command: str) -> str | None:
    try:
        return subprocess.run(command, capture_output=True, text=True, timeout=20, check=True).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return None


def timed(run: Callable[[], Any], synchronize: Callable[[], None], runs: int, warmups: int = 2) -> dict[str, Any]:
    """Median, least and all wall-clock times [s] of ``runs`` calls after ``warmups`` that are not counted."""
    for _ in range(warmups):
        run()
    synchronize()
    seconds = []
    for _ in range(runs):
        start = time.perf_counter()
        run()
        synchronize()
        seconds.append(time.perf_counter() - start)
    return {"median_s": median(seconds), "least_s": min(seconds), "runs_s": [round(s, 6) for s in seconds]}


def peer(script: str, *arguments: object) -> dict[str, Any]:
    """The record a peer's script prints, or {"missing": why}. Its Python is VAM_PEERS_PYTHON, by default .peers'."""
    python = os.environ.get("VAM_PEERS_PYTHON", str(HERE.parent / ".peers" / "bin" / "python"))
    command = [python, str(HERE / "peers" / script), *map(str, arguments)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    except OSError as error:
        return {"missing": f"{error}; run peers/install.sh or set VAM_PEERS_PYTHON"}
    if done.returncode:
        return {"missing": (done.stderr.strip().splitlines() or ["no reason given"])[-1]}
    return json.loads(done.stdout.strip().splitlines()[-1])


def chosen_devices(names: list[str]) -> list[Any]:
    """Devices by name; ``cpu`` and ``gpu`` stand for all of a kind but the reference."""
    import vamgpu

    out: list[str] = []
    for name in names:
        group = [n for n in vamgpu.devices() if n != "numpy"] if name in ("cpu", "gpu") else [name]
        out += [n for n in group if name not in ("cpu", "gpu") or is_gpu(vamgpu.open_device(n)) == (name == "gpu")]
    if not out:
        sys.exit(f"no device of {names} works here")
    return [vamgpu.open_device(name) for name in dict.fromkeys(out)]


def is_gpu(device: Any) -> bool:
    """Whether a device is a graphics processor."""
    return "cuda" in device.name or bool(getattr(device, "is_gpu", False))


def write_record(folder: Path, name: str, record: dict[str, Any]) -> Path:
    """Keep a record as ``name``.json."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{name}.json"
    path.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    return path


def benchy(mesh: Path, n: int, device: Any, pitch: float = 0.1) -> Any:
    """The mesh as a target of n³ voxels, its enclosing circle filling `FILL` of the width."""
    import vamgpu
    from vamgpu.targets.mesh import load_mesh

    if not mesh.exists():
        sys.exit(f"{mesh} is not there; give the mesh with --mesh")
    solid = load_mesh(mesh)
    factor = FILL * 0.5 * n * pitch / solid.radius
    return vamgpu.Target.from_mesh(solid, factor=factor, pitch=pitch, margin=0, shape=(n, n, n), device=device)


def gear(size: int = 64, pitch: float = 0.12) -> Any:
    """Nine teeth, two holes of different sizes and a slit, (size, size, 2)."""
    import numpy as np

    at = (np.arange(size) - 0.5 * (size - 1)) * pitch
    x, y = np.meshgrid(at, at, indexing="ij")
    part = np.hypot(x, y) < 2.85 + 0.45 * np.sign(np.cos(9.0 * np.arctan2(y, x)))
    part &= (np.hypot(x - 1.3, y) >= 0.55) & (np.hypot(x + 1.3, y) >= 0.4)
    part &= (np.abs(x) >= 0.25) | (np.abs(y) >= 1.9)
    return np.repeat(part[:, :, None], 2, axis=2).astype(np.float32)

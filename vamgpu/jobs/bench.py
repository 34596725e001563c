"""Time the projection operators on this machine's devices, or the stages of a job."""

from __future__ import annotations

import platform
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass
from math import prod
from os import cpu_count
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from vamgpu.backend import devices, open_device
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.geometry import Beam, Grid, Turntable
from vamgpu.jobs.read import Job
from vamgpu.jobs.run import prove, solve
from vamgpu.methods.choice import chosen
from vamgpu.methods.surface import finer_voxels
from vamgpu.operators.compose import combine
from vamgpu.operators.projection import Projection
from vamgpu.optics.vial import Vial

RADIUS = 12.4  # outer radius of the bench's vial [mm]


@dataclass(frozen=True)
class Timing:
    """Medians [s] of one operator on one device: projection of n³ voxels at ``angles`` angles, and back projection."""

    device: str
    operator: str
    n: int
    angles: int
    forward: float
    back: float


def machine() -> dict[str, Any]:
    """Description of this machine."""
    return {
        "system": platform.platform(),
        "processor": _processor(),
        "cores": cpu_count(),
        "python": platform.python_version(),
    }


def _processor() -> str:
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as file:
            return next(line.split(":", 1)[1].strip() for line in file if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()


def projectors(n: int, angles: int, device: Device) -> dict[str, Projection]:
    """The timed operators: straight rays, and rays that a vial refracts and absorbs."""
    pitch = 1.2 * RADIUS / n
    vial = Vial(radius=RADIUS, wall=1.0, resin_index=1.49962, wall_index=1.473, bath_index=1.0, absorption=0.05)
    grid, motion = Grid((n, n, n), pitch), Turntable(angles)
    return {
        "straight": Projection(grid, Beam((n, n), pitch), motion, None, device),
        "vial": Projection(grid, Beam((n, n), 1.5 * pitch), motion, vial, device),
    }


def bench(n: int = 128, angles: int = 360, repeats: int = 5, names: Iterable[str] | None = None) -> Iterator[Timing]:
    """Time the operators on devices. Raises `BadInput`, `DeviceError`."""
    for what, value in (("size", n), ("angles", angles), ("repeats", repeats)):
        if value < 1:
            raise BadInput(f"{what} is {value}; expected at least 1")
    chosen = tuple(names) if names is not None else tuple(name for name in devices() if name != "numpy")
    for name in chosen:
        device = open_device(name)
        for kind, A in projectors(n, angles, device).items():
            x, y = device.upload(_ball(n)), device.empty(A.range.shape)
            back = device.empty(A.domain.shape)
            forward = _median(lambda A=A, x=x, y=y: A(x, out=y), device, repeats)
            backward = _median(lambda A=A, y=y, x=back: A.T(y, out=x), device, repeats)
            yield Timing(name, kind, n, angles, forward, backward)


def table(timings: Iterable[Timing]) -> list[dict[str, Any]]:
    """Turn timings into plain records."""
    return [asdict(t) | {"giga_updates": t.n**3 * t.angles / t.forward / 1e9} for t in timings]


@dataclass(frozen=True)
class Stage:
    name: str  # name of the stage, as in a progress bar
    seconds: float
    least: float | None = None  # least time for its bytes at the device's bandwidth [s]; None if they are not counted


def stages(job: Job) -> list[Stage]:
    """Solve, prove and report a job in a temporary folder. Raises as `vamgpu.jobs.run.solve` does."""
    watched = _Watched()
    device = open_device(job.file.solve.device)
    with TemporaryDirectory(prefix="vamgpu-bench-") as place:
        folder = solve(job, Path(place) / "job.vam", progress=watched)
        proven = prove(folder.path, device.name, progress=watched)
        watched("report", 0.0)
        proven.report(Path(place) / "job.html")
        watched("", 0.0)
        spent, A = proven.plan.history[-1]["evaluations"] if proven.plan.history else 0.0, proven.proof.operator
    grid = finer_voxels(job.file.method or chosen(job.file.solve.method), A, proven.proof)
    fields = prod((A.grid if grid is None else grid).shape) + prod(A.range.shape)
    least = 2.0 * spent * fields * device.real.itemsize / bandwidth(device)  # an evaluation moves both fields twice
    return [Stage(name, each, least if name == "light" else None) for name, each in watched.took.items()]


class _Watched:
    """Seconds of each stage."""

    def __init__(self) -> None:
        self.took: dict[str, float] = {}
        self._last, self._began = "open", time.perf_counter()

    def __call__(self, stage: str, share: float) -> None:
        if stage != self._last:
            now = time.perf_counter()
            self.took[self._last] = self.took.get(self._last, 0.0) + now - self._began
            self._last, self._began = stage, now

    def tell(self, text: str) -> None:
        """Messages are not part of a job's time."""


def bandwidth(device: Device, nbytes: int = 1 << 28) -> float:
    """Bytes that a device reads and writes per second, measured by copying a field."""
    shape = (64, 64, nbytes // (64 * 64 * device.real.itemsize))
    x = device.upload(np.ones(shape, device.real))
    out = device.empty(shape)
    return 2.0 * nbytes / _median(lambda: combine(1.0, x, 0.0, x, out), device, 5)


def _ball(n: int) -> np.ndarray:
    x = np.linspace(-1, 1, n)
    return (x[:, None, None] ** 2 + x[None, :, None] ** 2 + x[None, None, :] ** 2 < 0.7).astype(np.float32)


def _median(run: Callable[[], Any], device: Device, repeats: int) -> float:
    """Median of the repeats, after one run that compiles."""
    run()
    device.synchronize()
    seconds = []
    for _ in range(repeats):
        start = time.perf_counter()
        run()
        device.synchronize()
        seconds.append(time.perf_counter() - start)
    return median(seconds)

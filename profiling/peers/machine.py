"""Describe the machine and the versions behind a timing, and time a call; shared by the peer scripts."""

from __future__ import annotations

import importlib.metadata
import json
import os
import platform
import resource
import statistics
import time
from collections.abc import Callable
from pathlib import Path


def machine(*packages: str) -> dict[str, object]:
    """Return processor, usable cores, memory [GB], Python and the versions of `packages`."""
    versions = {}
    for name in packages:
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            versions[name] = None
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9
    return {
        "processor": _processor(),
        "cores": len(os.sched_getaffinity(0)),
        "memory_gb": round(memory, 1),
        "load_1min": round(os.getloadavg()[0], 2),
        "python": platform.python_version(),
        "packages": versions,
    }


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def median_seconds(call: Callable[[], object], runs: int, warmups: int = 1) -> tuple[float, list[float]]:
    """Return the median and all wall-clock times [s] of `runs` calls, after `warmups` calls that are not counted."""
    for _ in range(warmups):
        call()
    times = []
    for _ in range(runs):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return statistics.median(times), [round(t, 5) for t in times]


def peak_gb() -> float:
    """Return this process's peak resident memory [GB]."""
    return round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9, 2)


def emit(record: dict[str, object]) -> None:
    """Print `record` as one JSON line."""
    print(json.dumps(record))

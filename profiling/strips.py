"""Time and memory of 64 slices of a vial on rings and by rays: what a job of any height is made of.

    python profiling/strips.py --n 1024 --angles 720 --memory 12GB --device opencl:intel:0

The system holds the process to its private memory, as in `memory.py`. A vial of n³ voxels takes n / 64 times as long a
product; its table is made once.
"""

from __future__ import annotations

import argparse
import resource
import time
from pathlib import Path
from typing import Any

import numpy as np
from common import machine, write_record
from memory import Watch

import vamgpu as vam
from vamgpu.backend import within
from vamgpu.quantity import bytes_of

VIAL = vam.Vial(radius=12.4, wall=1.0, resin_index=1.49962, wall_index=1.473, absorption=0.05)
WIDTH = 14.8
"""Of the grid [mm]."""
SLICES = 64


def measured(n: int, angles: int, name: str, runs: int) -> dict[str, Any]:
    """Stages, and the least times of products."""
    watch, pitch = Watch(), WIDTH / n
    geometry = (vam.Grid((n, n, SLICES), pitch), vam.Beam((3 * n // 2, SLICES), pitch), vam.Turntable(angles), VIAL)
    watch("table of rings")
    A = vam.RingProjection(*geometry, device=name)
    watch("volume")
    volume = A.device.upload(np.random.default_rng(0).random(A.domain.shape, np.float32))
    least: dict[str, dict[str, float]] = {}
    for kind, operator in (("rings", A), ("rays", A.direct)):
        light, dose = operator(volume), A.device.empty(A.domain.shape)
        for _ in range(runs):
            ways = (("forward", operator, volume, light), ("back", operator.T, light, dose))
            for way, product, source, found in ways:
                watch(f"{kind}, {way}")
                began, worked = time.perf_counter(), time.process_time()
                product(source, out=found)
                A.device.synchronize()
                took = {"seconds": time.perf_counter() - began, "processor_seconds": time.process_time() - worked}
                before = least.setdefault(f"{kind}, {way}", took)
                least[f"{kind}, {way}"] = {key: min(took[key], before[key]) for key in took}
    watch("end")
    watch.rows.pop("end", None)
    return {"stages": watch.rows, "least": least}


def main() -> None:
    """Measure and write the record."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--n", type=int, default=128)
    options.add_argument("--angles", type=int, default=180)
    options.add_argument("--memory", default="4GB")
    options.add_argument("--device", default="opencl:pocl:0", help="a processor through OpenCL")
    options.add_argument("--runs", type=int, default=2)
    options.add_argument("--records", type=Path, default=None)
    options.add_argument("--label", default="here")
    asked = options.parse_args()
    limit = bytes_of(asked.memory) or 0
    resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))
    name = within(asked.device, asked.memory)
    found = measured(asked.n, asked.angles, name, asked.runs)
    for what, row in found["least"].items():
        print(f"{what}: {row['seconds']:.2f} s ({row['processor_seconds']:.2f} s of processors)")
    if asked.records:
        asks = {key: value for key, value in vars(asked).items() if isinstance(value, (str, int, float))}
        write_record(asked.records, f"strips-{asked.label}-{asked.n}", {"machine": machine(), "asked": asks, **found})


if __name__ == "__main__":
    main()

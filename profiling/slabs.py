"""Time projectors and optimizer steps on one device, and on several that share the slices.

    python profiling/slabs.py --n 512 --angles 360 --devices opencl:nvidia:0 "opencl:nvidia:*"

The first device is the one alone; gains are its seconds over those of the others.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np
from common import machine, timed, write_record

import vamgpu as vam
from vamgpu.backend.device import Device

VIAL = vam.Vial(radius=12.4, wall=1.0, resin_index=1.5, wall_index=1.473, absorption=0.05)
WIDTH = 14.8
"""Of the grid [mm]."""
STEPS = (10, 30)
"""Evaluations of two runs; the difference of their seconds is that of steps alone."""


def one(device: Device, n: int, angles: int, runs: int, algorithm: str) -> dict[str, Any]:
    """Seconds of a forward and a back projection in a vial, and of an evaluation of the optimizer."""
    pitch = WIDTH / n
    grid, beam = vam.Grid((n, n, n), pitch), vam.Beam((n, n), 1.5 * pitch)
    A = vam.projector(grid, beam, vam.Turntable(angles), VIAL, device=device, algorithm=algorithm)
    places = (np.arange(n, dtype=np.float32) - 0.5 * (n - 1)) / n
    across = places[:, None, None] ** 2 + places[None, :, None] ** 2
    part = (across < 0.1) & (across > 0.03) & (np.abs(places) < 0.4)
    volume = device.upload(part.astype(np.float32))
    light, dose = A(volume), device.empty(grid.shape)
    A.T(light, out=dose)  # compiles
    found = {
        "forward": timed(lambda: A(volume, out=light), device.synchronize, runs)["median_s"],
        "back": timed(lambda: A.T(light, out=dose), device.synchronize, runs)["median_s"],
    }
    if algorithm == "rings":
        target, took = vam.Target.from_array(part, pitch=pitch), []
        for steps in (1, *STEPS):
            start = time.perf_counter()
            plan = vam.optimize(A, target, iterations=steps, progress=False)
            took.append(time.perf_counter() - start)
            found |= {"window": plan.window}
        found |= {"optimize": took[-1], "step": (took[2] - took[1]) / (STEPS[1] - STEPS[0])}
    return {**found, "peak_GB": device.ledger.peak / 1e9}


def main() -> None:
    """Time every device and write the record."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--n", type=int, default=128)
    options.add_argument("--angles", type=int, default=180)
    options.add_argument("--runs", type=int, default=3)
    options.add_argument("--devices", nargs="+", required=True)
    options.add_argument("--algorithms", nargs="+", default=["rings", "rays"])
    options.add_argument("--records", type=Path, default=None)
    options.add_argument("--label", default="here")
    asked = options.parse_args()
    devices = [vam.open_device(name) for name in asked.devices]
    rows = {}
    for algorithm in asked.algorithms:
        for device in devices:
            row = rows[f"{algorithm} on {device.name}"] = one(device, asked.n, asked.angles, asked.runs, algorithm)
            alone = rows[f"{algorithm} on {devices[0].name}"]
            gains = ", ".join(f"{key} {1e3 * row[key]:.2f} ms ({alone[key] / row[key]:.2f}×)"
                              for key in ("forward", "back", "step", "optimize") if key in row)  # fmt: skip
            print(f"{algorithm} on {device.name}: {gains}, {row['peak_GB']:.2f} GB", flush=True)
    if asked.records:
        write_record(asked.records, f"slabs-{asked.label}-{asked.n}", {"machine": machine(*devices), "rows": rows})


if __name__ == "__main__":
    main()

"""Re-tracing rays through varying index: a launch over tables that lie on the device already, on every device here.

    python profiling/rays.py --rays 1000 --steps 500

Every ray runs all its steps through a Luneburg lens, as a formula, on a grid of 256² and on one of 64³. NumPy marches
for comparison. The time is wall clock of a launch until it is done, least and median of --runs; `load` tells how busy
the machine was.
"""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
from common import HERE, chosen_devices, machine, timed, write_record

from vamgpu.backend.device import Device
from vamgpu.optics.index_field import FormulaField, GridField, IndexField
from vamgpu.optics.march import Marcher

GOAL_MS = 5.0
"""For 1,000 rays of 500 steps on a processor of two cores."""


def index(*at: np.ndarray) -> np.ndarray:
    """A Luneburg lens of radius 1; the corners of the grid, which no ray reaches, are kept real."""
    return np.sqrt(np.maximum(2.0 - sum(a**2 for a in at), 0.3))


def media() -> dict[str, IndexField]:
    """Formula, plane and volume of one lens."""
    return {
        "formula": FormulaField((1.0, 1.0, 1.0), (2.0, -1.0)),
        "grid 256^2": GridField.from_function(index, (256, 256), 2.2 / 255),
        "grid 64^3": GridField.from_function(index, (64, 64, 64), 2.2 / 63),
    }


def measured(device: Device, field: IndexField, rays: int, steps: int, runs: int) -> dict[str, Any]:
    """Times of one device and the largest distance of an end from the focus, in radii."""
    marcher, p = Marcher(field, device), np.linspace(-0.95, 0.95, rays)
    place = np.stack([-np.sqrt(1.0 - p**2), p], axis=1)
    starts, step = device.table(marcher.starts(place, np.tile([1.0, 0.0], (rays, 1)))), 0.5 * np.pi / steps
    tables = marcher.run(starts, step, steps)

    def again() -> None:
        marcher.run(starts, step, steps)

    spent = timed(again, device.synchronize, runs)
    miss = np.abs(tables[0].numpy()[:, :3] - [1.0, 0.0, 0.0]).max()
    return {"median_ms": 1e3 * spent["median_s"], "least_ms": 1e3 * spent["least_s"], "miss": float(miss)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rays", type=int, default=1000)
    parser.add_argument("--steps", type=int, default=500)
    parser.add_argument("--runs", type=int, default=25)
    parser.add_argument("--devices", nargs="+", default=["cpu", "gpu", "numpy"])
    parser.add_argument("--label", default="cpu")
    parser.add_argument("--records", type=Path, default=HERE / "records")
    options = parser.parse_args()
    names = [name for name in options.devices if name != "gpu" or _has_gpu()]
    devices = chosen_devices(names)
    record: dict[str, Any] = {"rays": options.rays, "steps": options.steps, "goal_ms": GOAL_MS, **machine(*devices)}
    record["load"] = list(os.getloadavg())
    results = record["results"] = {}
    for device in devices:
        for name, field in media().items():
            runs = 2 if device.name == "numpy" else options.runs
            found = results[f"{device.name}, {name}"] = measured(device, field, options.rays, options.steps, runs)
            print(f"{device.name:16} {name:12} least {found['least_ms']:9.3f} ms   median {found['median_ms']:9.3f} ms"
                  f"   off the focus by {found['miss']:.1e} R", flush=True)  # fmt: skip
    print(json.dumps({"record": str(write_record(options.records, f"rays-{options.label}", record))}))


def _has_gpu() -> bool:
    import vamgpu

    return any("cuda" in name or getattr(vamgpu.open_device(name), "is_gpu", False) for name in vamgpu.devices())


if __name__ == "__main__":
    main()

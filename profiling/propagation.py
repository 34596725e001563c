"""Time the rays through a film about a roller, and the building of its propagation.

A web needs one pose; a turntable needs every angle. Two sizes are therefore timed: one pose as it is used, and one pose
with 360 rays a column, which is as many rays as a turntable of 360 angles has and the fair one to hold against it. Of
VAMToolbox's ray tracer there are only the times quoted below; they were measured before, on a machine of this kind, and
are not measured here.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from common import HERE, machine, write_record

from vamgpu.geometry import Beam
from vamgpu.optics.film import Film
from vamgpu.optics.roller import Roller
from vamgpu.web import WebGrid

QUOTED = {"trace_256_s": (14.2, 17.4), "matrix_128_s": 69.0}
"""VAMToolbox, torch on this kind of processor: tracing 256² × 360 angles (least, most), its matrix at 128² × 360."""
ANGLES = 360
ROLLER = Roller(7.5, Film(3.0, 1.49, 1.33, 0.22), np.radians(0.5))


def measured(run: Callable[[], Any], runs: int) -> dict[str, float]:
    """Median wall-clock and processor time [s] after one call that is not counted."""
    run()
    wall, cpu = [], []
    for _ in range(runs):
        start, begun = time.perf_counter(), time.process_time()
        run()
        wall.append(time.perf_counter() - start)
        cpu.append(time.process_time() - begun)
    return {"median_s": median(wall), "least_s": min(wall), "cpu_s": median(cpu)}


def one(n: int, rays: int, runs: int) -> dict[str, Any]:
    """n columns of ``rays`` rays, n layers, and a window of about n columns."""
    roller = replace(ROLLER, rays=rays)
    # A hair wide, so that rounding does not add a column.
    grid = WebGrid((n, n, 1), (roller.map().length / n * (1 + 1e-9), roller.film.thickness / n, 0.1))
    beam = Beam((n, 1), 2.0 * roller.outer / n)
    offsets, leans = roller._bundle(beam.pitch)
    u, leg = beam.columns()[:, None, None] + offsets[:, None], roller.map(grid).leg
    light = roller.propagation(grid, beam)
    return {
        "columns": n, "layers": n, "window": light.shape[2], "rays": n * rays, "entries": light.weight.size,
        "trace": measured(lambda: roller.trace(u, leans, leg), runs),
        "build": measured(lambda: roller.propagation(grid, beam), runs),
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--label", default="cpu")
    parser.add_argument("--records", type=Path, default=HERE / "records")
    arguments = parser.parse_args()
    record: dict[str, Any] = {"machine": machine(), "quoted": QUOTED}
    for n in (128, 256):
        record[f"one pose, {n}"] = one(n, ROLLER.rays, arguments.runs)
        record[f"as many rays as {ANGLES} angles, {n}"] = one(n, ANGLES, arguments.runs)
    many = {n: record[f"as many rays as {ANGLES} angles, {n}"] for n in (128, 256)}
    record["times_faster"] = {
        "tracing alone, equal rays, against 256² × 360": QUOTED["trace_256_s"][0] / many[256]["trace"]["median_s"],
        "tracing and matrix, equal rays, against 256² × 360 tracing": QUOTED["trace_256_s"][0]
        / many[256]["build"]["median_s"],
        "matrix, equal rays, against 128² × 360": QUOTED["matrix_128_s"] / many[128]["build"]["median_s"],
        "matrix as used, one pose, against 128² × 360": QUOTED["matrix_128_s"]
        / record["one pose, 128"]["build"]["median_s"],
    }
    for name, value in record["times_faster"].items():
        print(f"{value:8.0f} times faster: {name}")
    print(write_record(arguments.records, f"propagation-{arguments.label}", record))


if __name__ == "__main__":
    main()

"""Time projector evaluations of rays traced anew at every pose, beside straight ones in the same run.

"level": a lens, an extinction and an insert that do not depend on z, traced once into a matrix for all slices. "deep":
the same as spheres, marched in every product, on a smaller grid; nanoseconds a step tell what a larger one takes.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from common import HERE, chosen_devices, machine, timed, write_record

from vamgpu.backend.device import Device
from vamgpu.geometry import Beam, Grid, Turntable
from vamgpu.kernels.trace import survey_rays
from vamgpu.operators.bundle import RayBundle
from vamgpu.operators.linear import LinearOperator
from vamgpu.operators.medium import CoRotatingMedium
from vamgpu.operators.projection import Projection
from vamgpu.operators.traced_projection import TracedProjection

WIDTH, BATH = 12.8, 1.485  # mm; refractive index


def carried(grid: Grid, *, deep: bool) -> CoRotatingMedium:
    """A cured lump, an extinction and a rod, or spheres."""
    x, y, z = np.meshgrid(*grid.axes(), indexing="ij") if deep else (*np.meshgrid(*grid.axes()[:2], indexing="ij"), 0.0)
    index = BATH + 0.02 * np.exp(-((x - 2.0) ** 2 + (y + 1.0) ** 2 + z**2) / 1.5)
    return CoRotatingMedium(index, 0.05, (x + 2.0) ** 2 + (y - 2.0) ** 2 + z**2 < 0.7, BATH)


def pair(A: LinearOperator, runs: int) -> dict[str, Any]:
    """Forward and back times of an operator."""
    device, rng = A.device, np.random.default_rng(0)
    volume, light = (device.upload(rng.random(space.shape, np.float32)) for space in (A.domain, A.range))
    shadow, dose = device.empty(A.range.shape), device.empty(A.domain.shape)
    calls: dict[str, Callable[[], Any]] = {
        "forward": lambda: A(volume, out=shadow),
        "back": lambda: A.T(light, out=dose),
    }
    return {name: timed(call, device.synchronize, runs) for name, call in calls.items()}


def level(n: int, slices: int, angles: int, device: Device, runs: int) -> dict[str, Any]:
    """A matrix for all slices, and straight light."""
    grid = Grid((n, n, slices), WIDTH / n)
    geometry = grid, Beam((n, slices), grid.pitch), Turntable(angles, lit_share=0)
    fields = carried(grid, deep=False)
    TracedProjection(*geometry, fields, device=device)  # compiles
    start = time.perf_counter()
    A = TracedProjection(*geometry, fields, device=device)
    built = time.perf_counter() - start
    gap = max(A.dot_test(seed) for seed in range(4))
    straight = pair(Projection(*geometry, device=device), runs)
    return {"build_s": built, "entries": A.entries, "gap": gap, "traced": pair(A, runs), "straight": straight}


def deep(n: int, slices: int, angles: int, device: Device, runs: int) -> dict[str, Any]:
    """Rays marched in every product."""
    grid = Grid((n, n, slices), WIDTH / n)
    beam, motion = Beam((n, slices), grid.pitch), Turntable(angles, lit_share=0)
    A = TracedProjection(grid, beam, motion, carried(grid, deep=True), device=device)
    out = {"steps": steps(A), "gap": max(A.dot_test(seed) for seed in range(4)), "traced": pair(A, runs)}
    for name in ("forward", "back"):
        out[f"{name}_ns_a_step"] = 1e9 * out["traced"][name]["least_s"] / out["steps"]
    return out


def steps(A: TracedProjection) -> int:
    """Steps of all rays together."""
    poses, device = A.motion.poses, A.device
    taken = device.empty((poses.size, A.beam.pixels[0] * A.beam.pixels[1]), np.int32, table=True)
    directions = device.table(np.stack([np.cos(poses), np.sin(poses)], axis=1))
    top, most = A.grid.shape[2] + 1.0, A.most_steps
    device.launch(survey_rays, **A._inputs(level=False), directions=directions, top=top, most=most, steps=taken)
    return int(taken.numpy().sum())


def thousand(device: Device, runs: int) -> dict[str, Any]:
    """A thousand level rays through the lens of 256 × 256 voxels, about 500 steps each."""
    grid = Grid((256, 256, 1), WIDTH / 256)
    beam, fields = Beam((1000, 1), 0.7 * WIDTH / 1000), CoRotatingMedium(carried(grid, deep=False).index, bath=BATH)
    A = TracedProjection(grid, beam, Turntable(1, lit_share=0), fields, RayBundle.parallel(beam), device)
    taken = device.empty((1, 1000), np.int32, table=True)
    inputs = A._inputs(level=True) | {"directions": device.table([[1.0, 0.0]]), "top": 1e6, "most": A.most_steps}
    out = timed(lambda: device.launch(survey_rays, **inputs, steps=taken), device.synchronize, runs)
    return out | {"steps": int(taken.numpy().sum())}


def told(name: str, found: dict[str, Any]) -> list[str]:
    """The lines that are printed of one device."""
    flat, marched, few = found["level"], found["deep"], found["thousand rays"]
    lines = []
    for kind in ("straight", "traced"):
        forward, back = (1e3 * flat[kind][way]["least_s"] for way in ("forward", "back"))
        lines.append(f"{name} {kind}: {forward:.1f} + {back:.1f} ms")
    lines.append(f"{name} built in {flat['build_s']:.2f} s, gaps {flat['gap']:.1e} and {marched['gap']:.1e}")
    lines.append(f"{name} deep: {marched['forward_ns_a_step']:.1f} and {marched['back_ns_a_step']:.1f} ns a step")
    lines.append(f"{name} thousand rays: {1e3 * few['least_s']:.2f} ms for {few['steps']} steps")
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--devices", nargs="+", default=["cpu"])
    parser.add_argument("--size", nargs=3, type=int, default=(128, 64, 180), metavar=("N", "SLICES", "ANGLES"))
    parser.add_argument("--deep", nargs=3, type=int, default=(64, 32, 30), metavar=("N", "SLICES", "ANGLES"))
    parser.add_argument("--runs", type=int, default=7)
    parser.add_argument("--out", type=Path, default=HERE / "records")
    chosen = parser.parse_args()
    devices = chosen_devices(chosen.devices)
    record: dict[str, Any] = {"machine": machine(*devices), "size": chosen.size, "deep_size": chosen.deep}
    for device in devices:
        found = {
            "level": level(*chosen.size, device, chosen.runs),
            "deep": deep(*chosen.deep, device, chosen.runs),
            "thousand rays": thousand(device, chosen.runs),
        }
        record[device.name] = found
        print(*told(device.name, found), sep="\n")
    print(write_record(chosen.out, "traced", record))


if __name__ == "__main__":
    main()

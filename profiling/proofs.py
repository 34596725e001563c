"""What frames claim and what they are worth: windows by the operator that solved and by traced rays, and their cost.

The README's vial job at half its resolution, and six parts in straight light: the Benchy and five bundled shapes. Each
is solved by the default method, packed to 8 bits and proved. The cost is that of the proof alone (tables included), of
the fine dose inside the judged cylinder, and out to the wall, all beside a forward and a back projection.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from common import HERE, MESH, chosen_devices, machine, timed, write_record

import vamgpu
from vamgpu.backend.device import Device
from vamgpu.printing.independent_exposure import IndependentExposure
from vamgpu.targets.shapes import build

VIAL = vamgpu.Vial(radius=12.4, wall=1.0, resin_index=1.49962, wall_index=1.473, bath_index=1.0, absorption=0.05)
SHAPES = ("exposure_disk", "crossing_channels", "gyroid_sphere", "gear_base", "nut")


def proved(A: vamgpu.Projection, target: Any, iterations: int) -> dict[str, Any]:
    """Both windows, their ratio, and the greatest dose beyond the cylinder over the threshold."""
    proof = vamgpu.simulate(A, vamgpu.pack(vamgpu.optimize(A, target, iterations=iterations)), target)
    return {
        "grid": A.grid.shape,
        "claimed": proof.claimed.window,
        "proved": proof.scores.window,
        "ratio": proof.ratio,
        "beyond_over_threshold": proof.outer_share,
    }


def parts(mesh: Path, device: Device, iterations: int, size: int) -> dict[str, Any]:
    """Windows of the vial job and of the six parts."""
    boat = vamgpu.Target.from_mesh(str(mesh), height=11.5, pitch=0.18)
    vial = vamgpu.Projection(boat.grid, vamgpu.Beam((180, 150), 0.134), vamgpu.Turntable(180), VIAL, device)
    out = {"vial": proved(vial, boat, iterations)}
    for name in ("benchy", *SHAPES):
        pitch = 16.0 / size
        target = boat if name == "benchy" else vamgpu.Target.from_mesh(build(name), factor=1, pitch=pitch)
        nx, ny, nz = target.grid.shape
        columns = int(np.ceil(np.hypot(nx, ny)))
        beam = vamgpu.Beam((columns, nz), target.grid.pitch)
        A = vamgpu.Projection(target.grid, beam, vamgpu.Turntable(180), None, device)
        out[name] = proved(A, target, iterations)
    return out


def cost(device: Device, n: int, angles: int, runs: int) -> dict[str, Any]:
    """Times of a pair and of proofs in a vial whose printable radius the grid's cylinder nearly fills."""
    pitch = 14.8 / n
    beam = vamgpu.Beam((n, n), 1.5 * pitch)
    A = vamgpu.Projection(vamgpu.Grid((n, n, n), pitch), beam, vamgpu.Turntable(angles), VIAL, device)
    rng = np.random.default_rng(0)
    volume = device.upload(rng.random(A.domain.shape, np.float32))
    light = device.upload(rng.random(A.range.shape, np.float32))
    sinogram, dose = device.empty(A.range.shape), device.empty(A.domain.shape)

    def fine(reach: float | None) -> None:
        for slab in IndependentExposure(A).fine(light, reach):
            del slab

    work = {
        "forward": lambda: A(volume, out=sinogram),
        "back": lambda: A.T(light, out=dose),
        "proof": lambda: IndependentExposure(A).averaged(light),
        "fine, in the cylinder": lambda: fine(A.grid.inscribed_radius),
        "fine, to the wall": lambda: fine(None),
    }
    return {name: timed(run, device.synchronize, runs, warmups=1) for name, run in work.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", action="append", default=[])
    parser.add_argument("--mesh", type=Path, default=MESH)
    parser.add_argument("--iterations", type=int, default=40)
    parser.add_argument("--size", type=int, default=96, help="voxels over 16 mm of the bundled shapes")
    parser.add_argument("--n", type=int, default=128)
    parser.add_argument("--angles", type=int, default=360)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--only", choices=("parts", "cost"))
    parser.add_argument("--out", type=Path, default=HERE / "records")
    given = parser.parse_args()
    devices = chosen_devices(given.device)
    record: dict[str, Any] = {"machine": machine(*devices)}
    for device in devices:
        found: dict[str, Any] = {}
        if given.only != "cost":
            found["parts"] = parts(given.mesh, device, given.iterations, given.size)
        if given.only != "parts":
            found["cost"] = cost(device, given.n, given.angles, given.runs)
        record[device.name] = found
    print(write_record(given.out, "proofs", record))


if __name__ == "__main__":
    main()

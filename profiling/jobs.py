"""Time whole jobs on the Benchy: the main job as a fresh process, voxelizing, and Dr.TVAM's benchmark job.

--job main      20 OSMO iterations at 128^3 x 360, everything from starting Python on: with empty and with warm caches
--job voxelize  the mesh at 256^3
--job drtvam    400 patterns of 400 x 400 pixels for 256^3 voxels in a vial, refracting and index-matched
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

from common import HERE, MESH, benchy, machine, timed, write_record

VAMTOOLBOX = 208.0
"""Seconds of the main job in VAMToolbox, measured before on a machine of this kind; not measured in this run."""

STARTED = "VAM_PROFILING_STARTED"
"""Environment variable: when the process of the main job was started, as time.time() tells it."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--job", choices=("main", "voxelize", "drtvam", "all"), default="all")
    parser.add_argument("--mesh", type=Path, default=MESH)
    parser.add_argument("--device", nargs="+", default=None, help="names; the best one here by default")
    parser.add_argument("--records", type=Path, default=HERE / "records")
    parser.add_argument("--label", default="here", help="of the machine, part of the records' names")
    parser.add_argument("--n", type=int, default=None, help="voxels along each axis, for less than the full size")
    parser.add_argument("--angles", type=int, default=360, help="of the main job")
    parser.add_argument("--method", choices=("osmo", "default", "lbfgs"), default="osmo", help="of the main job")
    parser.add_argument("--iterations", type=int, default=None)
    parser.add_argument("--efficiency", type=float, default=None, help="drtvam by L-BFGS with this price of light")
    parser.add_argument("--rings", action="store_true", help="compute the main job and drtvam on rings")
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.child:
        print(json.dumps(main_job(args)))
        return
    import vamgpu

    for name in args.device or [vamgpu.backend.default_device()]:
        device = vamgpu.open_device(name)
        for job in ("main", "voxelize", "drtvam") if args.job == "all" else (args.job,):
            record = {"job": job, "device": name, "machine": machine(device)} | JOBS[job](args, device)
            label = f"{job}{'-rings' * args.rings}-{name.replace(':', '-')}-{args.label}"
            print(f"{job} on {name}: {json.dumps(record['result'], indent=1)}")
            print(write_record(args.records, label, record), flush=True)


# ---- the main job ------------------------------------------------------------------------------------------------
def main_process(args: argparse.Namespace, device: Any) -> dict[str, Any]:
    """The main job twice in processes of its own: with empty caches of compiled kernels, then with those it left."""
    results: dict[str, Any] = {}
    command = [sys.executable, __file__, "--child", "--device", device.name, "--mesh", str(args.mesh)]
    command += ["--n", str(args.n or 128), "--angles", str(args.angles), "--method", args.method]
    command += ["--iterations", str(args.iterations or 20), *["--rings"] * args.rings]
    with tempfile.TemporaryDirectory() as folder:
        names = ("XDG_CACHE_HOME", "POCL_CACHE_DIR", "WARP_CACHE_PATH", "CUDA_CACHE_PATH")
        surroundings = {**os.environ} | {name: str(Path(folder) / name.lower()) for name in names}
        for name in names:
            (Path(folder) / name.lower()).mkdir()
        for caches in ("empty", "warm"):
            start = time.perf_counter()
            surroundings[STARTED] = str(time.time())
            done = subprocess.run(command, env=surroundings, capture_output=True, text=True, check=False)
            seconds = time.perf_counter() - start
            if done.returncode:
                sys.exit(done.stderr)
            inside = json.loads(done.stdout.strip().splitlines()[-1])
            results[f"{caches} caches"] = {"process_s": round(seconds, 3)} | inside
            if args.method == "osmo" and (args.n, args.angles, args.iterations) in ((None, 360, None), (128, 360, 20)):
                results[f"{caches} caches"]["faster_than_vamtoolbox"] = round(VAMTOOLBOX / inside["start_to_plan_s"], 1)
    note = f"VAMToolbox: {VAMTOOLBOX:g} s, measured before on a machine of this kind, not in this run"
    return {"result": results, "peer": note}


def main_job(args: argparse.Namespace) -> dict[str, Any]:
    """The job itself, timed stage by stage inside the process."""
    last = time.perf_counter()
    stages: dict[str, float] = {}

    def stage(name: str) -> None:
        nonlocal last
        now = time.perf_counter()
        stages[name], last = round(now - last, 3), now

    import vamgpu

    n, (name,) = args.n, args.device
    device = vamgpu.open_device(name)
    stage("import and open_s")
    target = benchy(args.mesh, n, device)
    stage("voxelize_s")
    beam, motion = vamgpu.Beam((n, n), target.grid.pitch), vamgpu.Turntable(args.angles)
    A: Any = vamgpu.Projection(target.grid, beam, motion, None, device)
    A = vamgpu.RingProjection.of(A) if args.rings else A
    stage("operator_s")
    device.ledger.transfers.clear()
    plan = vamgpu.optimize(A, target, args.method, iterations=args.iterations)
    stage("optimize_s")
    to_plan = time.time() - float(os.environ[STARTED])
    within = transfers(device)
    limit = 3 * 4 * n * n * (n + args.angles)
    frames = vamgpu.pack(plan)
    proof = vamgpu.simulate(A, frames, target)
    stage("pack and simulate_s")
    return {
        "start_to_plan_s": round(to_plan, 3),
        **stages,
        "pairs": plan.evaluations,
        "window": round(plan.window, 4),
        "iou_8_bit": round(proof.scores.iou, 6),
        "peak_device_mb": round(device.ledger.peak / 1e6, 2),
        "peak_over_3_volumes_and_3_sinograms": round(device.ledger.peak / limit, 3),
        "transfers_while_optimizing": within,
    }


def transfers(device: Any) -> dict[str, Any]:
    """Crossings of more than 4 kB since the ledger was cleared, and how many smaller ones there were in all."""
    out: dict[str, list[int]] = defaultdict(list)
    for direction, size in device.ledger.transfers:
        out[direction].append(size)
    return {way: {"count": len(sizes), "bytes": sum(sizes)} for way, sizes in out.items()} | {
        "small ones in the whole process": device.ledger.small
    }


# ---- voxelizing --------------------------------------------------------------------------------------------------
def voxelizing(args: argparse.Namespace, device: Any) -> dict[str, Any]:
    """The mesh at 256^3: the first call with file and compilation, then medians from the file and from the solid."""
    from vamgpu.targets.mesh import load_mesh
    from vamgpu.targets.voxelize import voxelize

    n = args.n or 256
    start = time.perf_counter()
    target = benchy(args.mesh, n, device)
    device.synchronize()
    first = time.perf_counter() - start
    solid = load_mesh(args.mesh)
    solid = solid.placed(factor=target.radius / solid.radius)
    result = {
        "n": n,
        "first_call_with_file_s": round(first, 4),
        "from_file_s": timed(lambda: benchy(args.mesh, n, device), device.synchronize, 3, warmups=1)["median_s"],
        "from_solid_s": timed(lambda: voxelize(solid, target.grid, device), device.synchronize, 5)["median_s"],
        "volume_error": target.volume / solid.volume - 1.0,
    }
    return {"result": result}


def drtvam(args: argparse.Namespace, device: Any) -> dict[str, Any]:
    """Dr.TVAM's benchmark job; see `drtvam.py`."""
    from drtvam import job

    return {"result": job(args.mesh, device, args.n or 256, args.iterations, args.efficiency, rings=args.rings)}


JOBS = {"main": main_process, "voxelize": voxelizing, "drtvam": drtvam}

if __name__ == "__main__":
    main()

"""Prints in resin that scatters: patterns that ignore it, and patterns of `ScatteringRings`, both proved with it.

python profiling/scattering.py gear --turbid 3          a gear in two dimensions
python profiling/scattering.py boat --turbid 1 --size 48
python profiling/scattering.py time --size 128          a pair of products beside that of a clear resin
python profiling/scattering.py job --mesh benchy.stl    Dr.TVAM's Benchy in a vial of resin that scatters, all included
python profiling/scattering.py beside --mesh benchy.stl --steps 40    the same beside Dr.TVAM, each by both judges

`beside` needs the command `drtvam` (version 0.9) of an environment of its own: VAM_DRTVAM names it.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from common import MESH, gear, machine, write_record

import vamgpu as vam
from vamgpu.jobs.foreign.drtvam import read_drtvam, write_drtvam
from vamgpu.targets import shapes
from vamgpu.targets.mesh import load_mesh

RADIUS, ABSORPTION, ANISOTROPY = 5.0, 0.06, 0.9


def flat_scene(device: Any) -> tuple[vam.Projection, Any]:
    """The gear in resin of the index of its vial."""
    vial = vam.Vial(RADIUS, 0.0, resin_index=1.5, wall_index=1.5, bath_index=1.5, absorption=ABSORPTION)
    part, motion = gear(), vam.Turntable(120, lit_share=0.0)
    return vam.Projection(vam.Grid((64, 64, 2), 0.12), vam.Beam((64, 1), 0.12), motion, vial, device), part


def boat_scene(size: int, angles: int, device: Any) -> tuple[vam.Projection, Any]:
    """The boat in a vial in air, with pixels that are a voxel wide in the resin."""
    vial = vam.Vial(RADIUS + 0.5, 0.5, resin_index=1.5, wall_index=1.473, absorption=ABSORPTION)
    pitch = 4.2 / size
    target = vam.Target.from_mesh(shapes.build("boat"), height=4.2, pitch=pitch)
    across = 2 * int(target.radius * 1.5 / (1.5 * pitch) / 2 + 4) * 2
    beam = vam.Beam((across, int(target.grid.shape[2] / 1.5) + 2), 1.5 * pitch)
    return vam.Projection(target.grid, beam, vam.Turntable(angles), vial, device), target


def compare(A: vam.Projection, target: Any, options: Any) -> None:
    """Patterns without and with scattering, proved with it."""
    began = time.perf_counter()
    S = vam.ScatteringRings(A, vam.Scattering(options.turbid / RADIUS, ANISOTROPY), options.tolerance, options.photons)
    print(f"{A.grid}; {S.terms} terms, table {time.perf_counter() - began:.1f} s", flush=True)
    for name, operator in (("ignored", vam.RingProjection.of(A)), ("scattering", S)):
        began = time.perf_counter()
        plan = vam.optimize(operator, target, method=options.method, evaluations=options.evaluations,
                            iterations=options.evaluations, progress=False)  # fmt: skip
        solved, began = time.perf_counter() - began, time.perf_counter()
        proof = vam.simulate(S, vam.pack(plan, bits=8), target)
        own, found = plan.window, proof.scores
        print(f"{name}: planned {own:+.4f}, claimed {proof.claimed.windows.strict:+.4f}, proved "
              f"{found.windows.strict:+.4f}, IoU {found.iou:.4f}; {solved:.1f} s, proof "
              f"{time.perf_counter() - began:.1f} s", flush=True)  # fmt: skip


def times(A: vam.Projection, options: Any) -> None:
    """Seconds of products, the shortest of three."""
    S = vam.ScatteringRings(A, vam.Scattering(options.turbid / RADIUS, ANISOTROPY), options.tolerance, options.photons)
    light = A.device.upload(np.ones(A.range.shape, np.float32))
    for name, operator in (("clear", vam.RingProjection.of(A)), ("scattering", S)):
        took = []
        for _ in range(4):
            began = time.perf_counter()
            dose = operator.T(light)
            A.device.synchronize()
            middle = time.perf_counter()
            operator(dose)
            A.device.synchronize()
            took.append((time.perf_counter() - middle, middle - began))
        forward, back = np.min(took[1:], axis=0)
        print(f"{name}: forward {1e3 * forward:.0f} ms, back {1e3 * back:.0f} ms", flush=True)
    print(f"{S.terms} terms", flush=True)


JOB = {"inner": 6.0, "outer": 7.0, "glass": 1.54, "resin": 1.347, "absorption": 0.08, "length": 8.0}
"""Dr.TVAM's benchmark [mm, 1/mm]; its beam is 10 mm wide, its frames and angles are 400 for 256 voxels."""


def published(options: argparse.Namespace) -> tuple[vam.Projection, vam.Scattering]:
    """The benchmark at `options.size` voxels along each axis, and its resin."""
    n, turns = options.size, round(400 * options.size / 256)
    vial = vam.Vial(JOB["outer"], JOB["outer"] - JOB["inner"], resin_index=JOB["resin"], wall_index=JOB["glass"],
                    absorption=JOB["absorption"])  # fmt: skip
    beam = vam.Beam((turns, turns), 10.0 / turns)
    A = vam.Projection(
        vam.Grid((n, n, n), options.side / n), beam, vam.Turntable(turns, lit_share=0.0), vial, options.device
    )
    return A, vam.Scattering(options.turbid / JOB["inner"], options.anisotropy)


def task(A: vam.Projection, resin: vam.Scattering, options: argparse.Namespace) -> dict[str, Any]:
    """The benchmark as a configuration of Dr.TVAM."""
    n, extinction = options.size, JOB["absorption"] + resin.coefficient
    g = options.anisotropy
    phase = {"type": "rayleigh"} if g == "rayleigh" else {"type": "hg", "g": g}
    medium = {"ior": JOB["resin"], "phase": phase, "extinction": extinction, "albedo": resin.coefficient / extinction}
    film = {"type": "vfilm", "resx": n, "resy": n, "resz": n}
    return {
        "vial": {"type": "cylindrical", "r_int": JOB["inner"], "r_ext": JOB["outer"], "ior": JOB["glass"],
                 "medium": medium},
        "projector": {"type": "collimated", "n_patterns": A.motion.angles, "resx": A.beam.pixels[0],
                      "resy": A.beam.pixels[1], "pixel_size": A.beam.pitch, "motion": "circular", "distance": 20},
        "sensor": {"type": "dda", **{f"scale{axis}": options.side for axis in "xyz"}, "film": film},
        "target": {"filename": "part.ply", "size": JOB["length"]},
        "loss": {"type": "threshold", "tl": 0.8, "tu": 0.95}, "transmission_only": True,
        "filter_radon": not options.every_pixel,
        "n_steps": options.steps, "spp": options.rays, "spp_ref": 16, "spp_grad": options.rays,
    }  # fmt: skip


def placed(A: vam.Projection, options: argparse.Namespace) -> vam.Target:
    """The part as Dr.TVAM places it, by the center of its bounding box."""
    solid = load_mesh(options.mesh, center=False)
    low, high = solid.bounds
    solid = solid.translated(-0.5 * (low + high)).scaled(JOB["length"] / float((high - low).max()))
    scene = vam.Scene([vam.Body(solid)], origin=(0.0, 0.0, 0.0))
    return scene.target(pitch=A.grid.pitch, margin=0, shape=A.grid.shape, device=A.device)


def solve(options: argparse.Namespace) -> None:
    """Patterns for the benchmark and the seconds of each stage; those in a folder that has patterns are judged."""
    began = time.perf_counter()
    stages: dict[str, float] = {}

    def done(stage: str) -> None:
        A.device.synchronize()
        stages[stage] = round(time.perf_counter() - began - sum(stages.values()), 2)

    A, resin = published(options)
    target = placed(A, options)
    done("voxels")
    S = vam.ScatteringRings(A, resin, options.tolerance, options.photons)
    done("photons")
    found: dict[str, Any] = {"stages": stages, "terms": S.terms}
    if options.judge:
        light: Any = read_drtvam(options.judge / "task.json", options.judge / "patterns.npz").light
        frames = vam.pack(S, light, bits=8)
    else:
        plan = vam.optimize(S, target, vam.LBFGS(efficiency=0.03), iterations=options.evaluations, progress=False)
        done("light")
        frames = vam.pack(plan, bits=8)
        frames.save(options.out / "frames.vam", overwrite=True)
        done("frames")
        found["evaluations"] = plan.evaluations
    if options.prove or options.judge:
        proof = vam.simulate(S, frames, target)
        done("proof")
        if options.prove:  # their judge tries thresholds up to 1.3 in units of its own
            light = frames.plan.sinogram.numpy()
            write_drtvam(light * (options.mean / light.mean()), options.out / "patterns.npz")
        found |= {"iou": round(proof.scores.iou, 5), "window": round(proof.scores.windows.strict, 4)}
        found |= {"claimed": round(proof.claimed.windows.strict, 4), "light": round(proof.mean_brightness, 4)}
    print(json.dumps(found))


def beside(options: argparse.Namespace) -> None:
    """The whole process of both programs, and each light by both judges."""
    A, resin = published(options)
    found: dict[str, Any] = {"machine": machine(A.device), "turbid": options.turbid, "voxels": options.size}
    found |= {"steps": options.steps, "rays": options.rays, "every_pixel": options.every_pixel}
    with tempfile.TemporaryDirectory() as folder:
        ours, others = Path(folder) / "ours", Path(folder) / "theirs"
        for place in (ours, others):
            place.mkdir()
            load_mesh(options.mesh, center=False).save(place / "part.ply")
            (place / "task.json").write_text(json.dumps(task(A, resin, options)), encoding="utf-8")
        job = [sys.executable, __file__, "job", *sys.argv[2:]]
        found["ours, first"] = called([*job, "--out", str(ours)])
        found["ours, later"] = called([*job, "--out", str(ours)])
        program = [os.environ.get("VAM_DRTVAM", "drtvam"), "--backend", options.backend]
        found["theirs"] = called([*program, str(others / "task.json")], others, options.steps)
        found["theirs, by our judge"] = called([*job, "--judge", str(others)])
        mean = float(np.load(others / "patterns.npz")["patterns"].mean())
        found["ours, by our judge"] = called([*job, "--out", str(ours), "--prove", "--mean", str(mean)])
        forward = ["--forward_mode", "--patterns", str(ours / "patterns.npz")]
        found["ours, by their judge"] = called([*program, *forward, str(ours / "task.json")], ours)
    print(json.dumps(found, indent=1))
    if options.records:
        write_record(options.records, f"scattering-beside-{options.label}", found)


def called(command: list[str], scores: Path | None = None, steps: int = 0) -> dict[str, Any]:
    """Seconds of a whole process and of a step, and the scores that it prints, or writes as Dr.TVAM does."""
    began = time.perf_counter()
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    found = {"process_s": round(time.perf_counter() - began, 1)}
    if done.returncode:
        return {**found, "missing": done.stderr[-1500:]}
    if bars := re.findall(rf"\b{steps}/{steps} \[[^\]]*?([\d.]+)s/it", done.stderr):
        found["step_s"] = float(bars[-1])
    text = done.stdout.splitlines()[-1] if scores is None else (scores / "output_metrics.json").read_text("utf-8")
    return {**found, **json.loads(text)}


def main() -> None:
    """Parse the command line and run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("gear", "boat", "time", "job", "beside"))
    parser.add_argument("--turbid", type=float, default=3.0, help="scattering events per radius of the resin")
    parser.add_argument("--size", type=int, default=48)
    parser.add_argument("--angles", type=int, default=180)
    parser.add_argument("--photons", type=int, default=4_000_000)
    parser.add_argument("--tolerance", type=float, default=0.01)
    parser.add_argument("--evaluations", type=int, default=200)
    parser.add_argument("--method", default="lbfgs")
    parser.add_argument("--device")
    parser.add_argument("--mesh", type=Path, default=MESH)
    parser.add_argument("--side", type=float, default=8.5, help="of the voxels [mm]")
    parser.add_argument("--anisotropy", type=float, default=ANISOTROPY)
    parser.add_argument("--out", type=Path, default=Path())
    parser.add_argument("--prove", action="store_true", help="judge the patterns of `job` by other photons")
    parser.add_argument("--judge", type=Path, help="folder with a task and patterns to judge instead")
    parser.add_argument("--mean", type=float, default=0.02, help="mean of the patterns that are written for Dr.TVAM")
    parser.add_argument("--steps", type=int, default=40, help="of Dr.TVAM")
    parser.add_argument("--rays", type=int, default=4, help="of Dr.TVAM, for each pixel")
    parser.add_argument("--every-pixel", action="store_true", help="of Dr.TVAM, also those that light no part")
    parser.add_argument("--backend", default="cuda", help="of Dr.TVAM")
    parser.add_argument("--records", type=Path)
    parser.add_argument("--label", default="cpu")
    options = parser.parse_args()
    if options.what in ("job", "beside"):
        return solve(options) if options.what == "job" else beside(options)
    if options.what == "gear":
        return compare(*flat_scene(options.device), options)
    A, target = boat_scene(options.size, options.angles, options.device)
    return times(A, options) if options.what == "time" else compare(A, target, options)


if __name__ == "__main__":
    main()

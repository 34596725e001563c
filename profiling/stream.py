"""Time and memory of an endless web: 600 mm × 3 mm at half a degree a pose, and a tenth of it.

Run: ``python profiling/stream.py [--lengths 60 600] [--iterations 100] [--record FILE]``; each length is a process of
its own, so that peaks do not mix, and the system holds its address space to --limit GiB.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from math import radians
from pathlib import Path

import numpy as np
from common import machine

from vamgpu.geometry import Beam
from vamgpu.optics.film import Film
from vamgpu.optics.roller import Roller
from vamgpu.targets.lattices import SheetGyroid
from vamgpu.webs.proof import prove_web
from vamgpu.webs.stream import Stream

PITCH = 0.08
"""Voxels along rho and z, and pixels of the beam [mm]."""


def web(length: float, iterations: int, core: float, device: str | None) -> Stream:
    """The paper's film on its roller: 79 µm a pose, 38 layers, 32 slices, a window of 55 mm; cells drift along l."""
    roller = Roller(7.5, Film(3.0, 1.49, 1.33, 0.22), radians(0.5))
    cells = SheetGyroid(3.0)

    def drifting(l: np.ndarray, rho: np.ndarray, z: np.ndarray) -> np.ndarray:  # noqa: E741 - the web's axis
        return cells(l + 2.0 * np.sin(l / 17.0), rho, z)

    pitch = (roller.advance, 3.0 / 38, PITCH)
    beam = Beam((262, 32), PITCH)
    return Stream(
        drifting, roller, beam, length=length, section=(38, 32), pitch=pitch, iterations=iterations, core=core,
        device=device,
    )  # fmt: skip


def measure(length: float, iterations: int, core: float, device: str | None) -> dict[str, object]:
    """Solve and prove one web in a folder that is thrown away."""
    with tempfile.TemporaryDirectory() as place:
        began, busy = time.perf_counter(), time.process_time()
        job = web(length, iterations, core, device)
        folder = job.write(
            Path(place) / "web.vam", progress=lambda done, of: print(f"  {done} of {of}", file=sys.stderr)
        )
        solved, worked = time.perf_counter() - began, time.process_time() - busy
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        proof = prove_web(folder, device=device)
        return {
            "length_mm": length, "iterations": iterations, "device": str(job.device), "frames": folder.frames,
            "window_columns": job.layout.window, "rays": 262, "segments": len(folder.segments),
            "seconds": round(solved, 1), "processor_seconds": round(worked, 1), "peak_mib": round(peak, 1),
            "peak_with_proof_mib": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, 1),
            "iou": proof.iou, "threshold": proof.threshold,
        }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--lengths", type=float, nargs="+", default=[60.0, 600.0])
    parser.add_argument("--iterations", type=int, default=100)
    parser.add_argument("--core", type=float, default=2.0)
    parser.add_argument("--limit", type=float, default=2.0, help="GiB of address space the system allows")
    parser.add_argument("--device")
    parser.add_argument("--record", type=Path)
    parser.add_argument("--one", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.one:
        resource.setrlimit(resource.RLIMIT_AS, (int(given.limit * 2**30),) * 2)
        print(json.dumps(measure(given.lengths[0], given.iterations, given.core, given.device)))
        return
    found = []
    for length in given.lengths:
        command = [sys.executable, __file__, "--one", "--lengths", str(length), "--core", str(given.core)]
        command += ["--limit", str(given.limit), "--iterations", str(given.iterations)]
        command += ["--device", given.device] if given.device else []
        done = json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout)
        found.append(done | {"limit_gib": given.limit, "machine": machine()})
        print(json.dumps(done, indent=1))
    if given.record is not None:
        given.record.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()

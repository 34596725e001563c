"""Time and memory of an endless web: 600 mm × 3 mm at half a degree a pose, and a tenth of it.

Run: ``python profiling/stream.py [--lengths 60 600] [--iterations 100] [--record FILE]``; each length is a process of
its own, so that peaks do not mix, and the system holds its address space to --limit GiB. ``--across 208 --limit 0``
takes voxels of 14.4 µm in place of 80.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from math import ceil, radians
from pathlib import Path

import numpy as np
from common import machine

from vamgpu.backend import open_device
from vamgpu.geometry import Beam
from vamgpu.optics.film import Film
from vamgpu.optics.roller import Roller
from vamgpu.targets.lattices import SheetGyroid
from vamgpu.targets.stream import tile
from vamgpu.web import WebGrid
from vamgpu.webs.proof import prove_web
from vamgpu.webs.stream import Stream

THICK, PITCH, ROWS = 3.0, 0.08, 32
"""Of the film [mm]; voxels along rho and z, and pixels of the beam [mm]; rows."""


class Cells:
    """Gyroids without an end: one of whole columns, again and again."""

    def __init__(self, across: int, along: float) -> None:
        columns = round(THICK / along)
        self.cells, self.stretched = SheetGyroid(THICK), THICK / (columns * along)
        self.one = tile(self, WebGrid((columns, across, across), (along, THICK / across, THICK / across)))

    def __call__(self, *place: np.ndarray) -> np.ndarray:
        return self.cells(self.stretched * place[0], *place[1:])

    def bound(self, *place: np.ndarray) -> np.ndarray:
        """At most the distance to the surface [mm]."""
        return self.cells.bound(self.stretched * place[0], *place[1:]) / max(self.stretched, 1.0)

    def __iter__(self) -> Iterator[np.ndarray]:
        while True:
            yield self.one


def web(length: float, iterations: int, core: float, device: str | None, across: int | None) -> Stream:
    """The paper's film on its roller: 79 µm a pose, a window of 55 mm.

    Of 38 layers, 32 slices and cells that drift along l; or, ``across`` layers and slices, of cubes or thinner.
    """
    roller = Roller(7.5, Film(THICK, 1.49, 1.33, 0.22), radians(0.5))
    cells = SheetGyroid(THICK)

    def drifting(l: np.ndarray, rho: np.ndarray, z: np.ndarray) -> np.ndarray:  # noqa: E741 - the web's axis
        return cells(l + 2.0 * np.sin(l / 17.0), rho, z)

    if across:
        fine = THICK / across
        along = roller.advance / ceil(roller.advance / fine)  # of a ratio, poses between take light at every column
        beam, section = Beam((ceil(262 * PITCH / fine), across), fine), (across, across)
        tiles, pitch = iter(Cells(across, along)), (along, fine, fine)
    else:
        beam, section = Beam((262, ROWS), PITCH), (38, ROWS)
        tiles, pitch = drifting, (roller.advance, THICK / 38, PITCH)
    return Stream(
        tiles, roller, beam, length=length, section=section, pitch=pitch,
        iterations=iterations, core=core, device=device,
    )  # fmt: skip


def measure(length: float, iterations: int, core: float, device: str | None, across: int | None) -> dict[str, object]:
    """Solve and prove one web in a folder that is thrown away."""
    with tempfile.TemporaryDirectory() as place:
        started = time.perf_counter()
        job = web(length, iterations, core, device, across)
        memory = open_device(job.device).ledger
        began, busy = time.perf_counter(), time.process_time()
        ends: list[float] = []

        def told(done: int, of: int | None) -> None:
            ends.append(time.perf_counter() - began)
            print(f"  {done} of {of} in {ends[-1]:.1f} s", file=sys.stderr, flush=True)

        folder = job.write(Path(place) / "web.vam", progress=told)
        solved, worked = time.perf_counter() - began, time.process_time() - busy
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        on_device = memory.peak
        job = None
        proving = time.perf_counter()
        proof = prove_web(folder, device=device)
        return {
            "length_mm": length, "iterations": iterations, "device": str(proof.device), "frames": folder.frames,
            "section": list(proof.grid.shape[1:]), "window_columns": folder.details["layout"]["window"],
            "rays": proof.beam.pixels[0], "segments": len(folder.segments), "ready_seconds": round(began - started, 1),
            "seconds": round(solved, 1), "seconds_at": [round(each, 1) for each in ends],
            "processor_seconds": round(worked, 1), "peak_mib": round(peak, 1),
            "peak_on_device_mib": round(on_device / 2**20, 1), "proof_seconds": round(time.perf_counter() - proving, 1),
            "peak_with_proof_mib": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, 1),
            "iou": proof.iou, "window": proof.window, "threshold": proof.threshold,
        }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--lengths", type=float, nargs="+", default=[60.0, 600.0])
    parser.add_argument("--iterations", type=int, default=100)
    parser.add_argument("--core", type=float, default=2.0)
    parser.add_argument("--limit", type=float, default=2.0, help="GiB of address space the system allows; 0 for any")
    parser.add_argument("--across", type=int, help="layers, and slices; cubes of a film's thickness over as many")
    parser.add_argument("--device")
    parser.add_argument("--record", type=Path)
    parser.add_argument("--one", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.one:
        if most := int(given.limit * 2**30):
            resource.setrlimit(resource.RLIMIT_AS, (most, most))
        print(json.dumps(measure(given.lengths[0], given.iterations, given.core, given.device, given.across)))
        return
    found = []
    for length in given.lengths:
        command = [sys.executable, __file__, "--one", "--lengths", str(length), "--core", str(given.core)]
        command += ["--limit", str(given.limit), "--iterations", str(given.iterations)]
        command += ["--device", given.device] if given.device else []
        command += ["--across", str(given.across)] if given.across else []
        done = json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout)
        found.append(done | {"limit_gib": given.limit, "machine": machine()})
        print(json.dumps(done, indent=1))
    if given.record is not None:
        given.record.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()

"""Slices of stereolithography from files to files: MB/s of every stage, and thousands of slices under a limit.

``python profiling/curethrough_files.py --slices 1000`` times reading, modeling, correcting and writing, each alone and
all at once; ``--limit 1`` corrects in a process whose data the system limits to so many GB (RLIMIT_DATA, which counts
what a process may write to: heaps, maps and arrays, but not the address space that OpenCL runtimes merely reserve).
MB are those of pixels, one byte each.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from common import machine

from vamgpu.backend import open_device
from vamgpu.curethrough.buffers import SliceBuffers
from vamgpu.curethrough.correction import Correction, Corrector
from vamgpu.curethrough.dose import Judge, blocks
from vamgpu.curethrough.images import encode
from vamgpu.curethrough.job import correct_stack
from vamgpu.curethrough.output import writing
from vamgpu.curethrough.printer import Printer, levels_of
from vamgpu.curethrough.stack import open_stack
from vamgpu.units import hour, mJ_cm3, mm, mW_cm2, um

PRINTER = Printer(2 * mm, 576 * mJ_cm3, 50 * um, 1000 * mm / hour, levels_of(100 * mW_cm2, 1 * mW_cm2))
MB = 1e6


def pictures(slices: int, ny: int, nx: int) -> np.ndarray:
    """A lattice of struts and plates between two plates; only a few slices are alike."""
    y, x = np.mgrid[:ny, :nx].astype(np.float32)
    out = np.zeros((slices, ny, nx), np.uint8)
    disk = np.hypot(x - nx / 2, y - ny / 2) < 0.46 * ny
    for k in range(slices):
        angle = k / 40.0
        struts = (np.sin(x / 31 + angle) * np.cos(y / 37 - angle) > 0.35) & disk
        out[k] = np.where(struts | (k % 90 < 8), 255, 0) * (np.abs(y - ny / 2) < 0.48 * ny)
    return out


def folder(place: Path, slices: int, ny: int, nx: int) -> Path:
    """A folder of slices; after the first 180 they repeat as links, which read like files of their own."""
    place.mkdir(parents=True)
    own = pictures(min(slices, 180), ny, nx)
    for k in range(slices):
        file = place / f"slice_{k:05d}.png"
        if k < len(own):
            file.write_bytes(encode(own[k], ".png"))
        else:
            os.link(place / f"slice_{k % len(own):05d}.png", file)
    return place


def seconds(run: Callable[[], Any]) -> tuple[float, float]:
    """Wall-clock time of a call, and what all threads of the process computed meanwhile."""
    start, busy = time.perf_counter(), time.process_time()
    run()
    return time.perf_counter() - start, time.process_time() - busy


def stages(place: Path, out: Path, device: str | None, dither: bool) -> dict[str, Any]:
    """MB/s of every stage alone, then of all at once."""
    correction, on = Correction(PRINTER, dither=dither), open_device(device)
    with open_stack(place) as stack:
        size = float(np.prod(stack.shape)) / MB
        packed = sum((place / name).stat().st_size for name in stack.names) / MB
        found = {"bytes of files": seconds(lambda: [(place / n).read_bytes() for n in stack.names])}
        found["read and decode"] = seconds(lambda: [stack[a:b].size for a, b in blocks(stack.shape[0])])
        whole = stack[0 : stack.shape[0]]
    plane = (int(whole.shape[1]), int(whole.shape[2]))
    for _ in range(2):  # the first compiles
        judge = Judge(PRINTER, plane, on)
        parts = [whole[a:b] for a, b in blocks(len(whole))]
        found["model"] = seconds(lambda judge=judge, parts=parts: [judge.step(part, part) for part in parts])
        corrector = Corrector(correction, whole.shape, on)
        out_of = SliceBuffers()
        found["correct"] = seconds(
            lambda corrector=corrector, out_of=out_of: [
                on.download(block.table, out_of.take(block.table.shape)).size for block in corrector.run(whole)
            ]
        )
    corrector = Corrector(correction, whole.shape, on)
    levels = np.zeros((corrector.slices, *plane), np.uint8)
    for block in corrector.run(whole):
        levels[block.start : block.start + block.table.shape[0]] = block.levels
    names = tuple(f"s{k:05d}.png" for k in range(len(levels)))

    def write() -> None:
        with writing(out / "written", names) as writer:
            for a, b in blocks(len(levels)):
                writer.write(a, levels[a:b])

    found["encode and write"] = seconds(write)
    with open_stack(place) as stack:
        found["all at once, scored twice"] = seconds(lambda: correct_stack(correction, stack, out / "all", device=on))
    written = sum(file.stat().st_size for file in (out / "all").glob("*.png")) / MB
    rates = {name: {"seconds": round(t, 3), "computing [s]": round(busy, 3), "MB/s": round(size / t)}
             for name, (t, busy) in found.items()}  # fmt: skip
    return {"pixels [MB]": size, "files [MB]": packed, "written [MB]": written, "device": on.name, "stages": rates}


def limited(place: Path, out: Path, device: str | None, gigabytes: float) -> dict[str, Any]:
    """Correct under RLIMIT_DATA; called in a process of its own."""
    bound = int(gigabytes * 1e9)
    resource.setrlimit(resource.RLIMIT_DATA, (bound, bound))
    with open_stack(place) as stack:
        taken, busy = seconds(lambda: correct_stack(Correction(PRINTER), stack, out / "limited", device=device))
        size = float(np.prod(stack.shape)) / MB
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / MB
    return {"limit [GB]": gigabytes, "pixels [MB]": size, "seconds": round(taken, 2), "computing [s]": round(busy, 2),
            "MB/s": round(size / taken), "largest resident [MB]": round(peak)}  # fmt: skip


def main() -> None:
    """Measure and print a record as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--slices", type=int, default=1000)
    parser.add_argument("--size", type=int, nargs=2, default=(800, 1280), metavar=("NY", "NX"))
    parser.add_argument("--device", default=None)
    parser.add_argument("--dither", action="store_true")
    parser.add_argument("--limit", type=float, default=0.0, help="GB of data; measures the whole under it")
    parser.add_argument("--inside", type=Path, default=None, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.inside is not None:
        out = arguments.inside
        print(json.dumps(limited(out / "slices", out, arguments.device, arguments.limit)))
        return
    out = Path(tempfile.mkdtemp(prefix="slices-"))
    try:
        place = folder(out / "slices", arguments.slices, *arguments.size)
        if arguments.limit:
            words = [sys.executable, __file__, "--limit", str(arguments.limit), "--inside", str(out)]
            words += ["--device", arguments.device] if arguments.device else []
            found = json.loads(subprocess.run(words, check=True, capture_output=True, text=True).stdout)
        else:
            found = stages(place, out, arguments.device, arguments.dither)
        print(json.dumps({"machine": machine(), "slices": arguments.slices, **found}, indent=2))
    finally:
        shutil.rmtree(out, ignore_errors=True)


if __name__ == "__main__":
    main()

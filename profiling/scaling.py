"""One, two, four, … devices of a host at the same work: products, optimizing, a whole job, a web, ten jobs.

    python profiling/scaling.py --sizes 512x360 1024x720 --whole 2048x1440x40 --web 600 --jobs 10
    python profiling/scaling.py --kind opencl:pocl --counts 1 2 --sizes 48x96 --whole 48x96x3 --web 10 --jobs 2

Sizes are voxels across × angles × evaluations. By default, the counts are the powers of two up to the number of devices
of the kind of the best one here; a processor is taken as often as asked for. Gains are seconds of one over those of
several. Parts whose option is missing are left out; for one that fails, the record has its message.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from common import machine, timed, write_record

import vamgpu as vam
from vamgpu.backend.device import Device
from vamgpu.jobs.demo import WEB_JOB

VIAL = vam.Vial(radius=12.4, wall=1.0, resin_index=1.5, wall_index=1.473, absorption=0.05)
WIDTH = 14.8
"""Of the grid [mm]."""
WHOLE = Path(__file__).with_name("whole.toml")
ACROSS = 304
"""Voxels across of that job."""
LAYERS = 208
"""Pixels of 14.4 um across the film of 3 mm."""


def products(device: Device, n: int, angles: int, algorithm: str, runs: int, iterations: int) -> dict[str, Any]:
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
    if algorithm == "rings" and iterations:
        target, ends = vam.Target.from_array(part, pitch=pitch), [time.perf_counter()]
        plan = vam.optimize(A, target, iterations=iterations, progress=lambda step: ends.append(time.perf_counter()))
        found |= {"optimize": time.perf_counter() - ends[0], "step": float(np.median(np.diff(ends[2:])))}
        found |= {"until_first_step": ends[1] - ends[0], "window": plan.window}
    return {**found, "peak_GB": device.ledger.peak / 1e9}


def command(*arguments: str) -> dict[str, Any]:
    """Seconds of a command of vam in a process of its own."""
    start = time.perf_counter()
    text = "from vamgpu.cli import main; raise SystemExit(main())"
    done = subprocess.run([sys.executable, "-c", text, *arguments], capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError((done.stderr.strip().splitlines() or ["no reason given"])[-1])
    return {"process": time.perf_counter() - start, "said": done.stdout.strip().splitlines()[-12:]}


def settings(n: int, angles: int, evaluations: int, device: str) -> list[str]:
    """The job of `WHOLE`, with the bundled boat, that many voxels across."""
    ratio = ACROSS / n
    return [f"--set={each}" for each in (
        "target.mesh=", 'target.shape="boat"', f'target.pitch="{45 * ratio} um"', f'beam.pitch="{67 * ratio} um"',
        f"beam.pixels=[{round(360 / ratio)}, {round(300 / ratio)}]", f"turntable.angles={angles}",
        f"solve.evaluations={evaluations}", f'solve.device="{device}"')]  # fmt: skip


def web(length: float, pitch: float, device: str, count: int, folder: Path) -> dict[str, Any]:
    """A web by segments, as tasks of as many workers."""
    job = folder / "web.toml"
    job.write_text(WEB_JOB, encoding="utf-8")
    own = ("web.length", f"{length} mm"), ("beam.pitch", f"{pitch} um"), ("solve.device", device)
    sets = [f'--set={key}="{value}"' for key, value in own]
    return command("solve", str(job), "--out", str(folder / f"web-{count}.vam"), f"--cluster=local:{count}", *sets)


def several(size: Sequence[int], number: int, device: str, count: int, folder: Path) -> dict[str, Any]:
    """Jobs that differ in the resin, as tasks of as many workers."""
    values = ",".join(f'"{0.05 + 0.001 * k:.3f} /mm"' for k in range(number))
    return command(
        "sweep", str(WHOLE), f"--vary=vial.absorption={values}", "--out", str(folder / f"jobs-{count}"),
        f"--cluster=local:{count}", *settings(*size, device)
    )  # fmt: skip


def compared(name: str, counts: Sequence[int], run: Callable[[int], dict[str, Any]]) -> dict[str, Any]:
    """One row per count, with the gains over the first one."""
    rows: dict[str, Any] = {}
    for count in counts:
        try:
            row = rows[str(count)] = run(count)
        except Exception as error:  # noqa: BLE001 - the other parts go on
            rows[str(count)] = {"failed": f"{type(error).__name__}: {error}"}
            print(f"{name} on {count}: {error}", flush=True)
            continue
        first = next(each for each in rows.values() if "failed" not in each)
        told = ", ".join(f"{key} {1e3 * row[key]:.1f} ms ({first[key] / row[key]:.2f} x)"
                         for key in ("forward", "back", "step", "until_first_step", "optimize", "process")
                         if key in row)  # fmt: skip
        print(f"{name} on {count}: {told}", flush=True)
    return rows


def numbers(text: str) -> list[int]:
    return [int(each) for each in text.split("x")]


def main() -> None:
    """Measure what was asked for, and write the record after each part."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--kind", help="what the names of the devices begin with, such as opencl:nvidia")
    options.add_argument("--counts", type=int, nargs="+")
    options.add_argument("--sizes", type=numbers, nargs="*", default=[], help="512x360 1024x720")
    options.add_argument("--algorithms", nargs="+", default=["rings"])
    options.add_argument("--runs", type=int, default=3)
    options.add_argument("--iterations", type=int, default=30, help="of the optimizer; 0 leaves it out")
    options.add_argument("--whole", type=numbers, help="voxels across x angles x evaluations, with proof and report")
    options.add_argument("--web", type=float, help="length [mm]")
    options.add_argument("--web-pitch", type=float, default=3000 / LAYERS, help="of its pixels [um]")
    options.add_argument("--jobs", type=int, help="their number")
    options.add_argument("--job", type=numbers, default=[304, 360, 40], help="voxels across x angles x evaluations")
    options.add_argument("--records", type=Path)
    options.add_argument("--label", default="here")
    asked = options.parse_args()
    kind = asked.kind or vam.devices()[0].rpartition(":")[0]
    names = [name for name in vam.devices() if name.startswith(kind)]
    counts = asked.counts or [2**k for k in range(len(names).bit_length())]
    joined = {count: "+".join(names[k % len(names)] for k in range(count)) for count in counts}
    found: dict[str, Any] = {"machine": machine(*(vam.open_device(name) for name in names)), "devices": joined}
    parts: list[tuple[str, Callable[[int], dict[str, Any]]]] = [
        (f"{n} x {angles} {algorithm}",
         lambda count, n=n, angles=angles, algorithm=algorithm: products(
             vam.open_device(joined[count]), n, angles, algorithm, asked.runs, asked.iterations))
        for algorithm in asked.algorithms for n, angles in asked.sizes
    ]  # fmt: skip
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        if asked.whole:
            parts.append(("whole", lambda count: command(
                "bench", "--job", str(WHOLE), *settings(*asked.whole, joined[count]))))  # fmt: skip
        if asked.web:
            parts.append(("web", lambda count: web(asked.web, asked.web_pitch, names[0], count, folder)))
        if asked.jobs:
            parts.append(("jobs", lambda count: several(asked.job, asked.jobs, names[0], count, folder)))
        for name, run in parts:
            found[name] = compared(name, counts, run)
            if asked.records:
                write_record(asked.records, f"scaling-{asked.label}", found)


if __name__ == "__main__":
    main()

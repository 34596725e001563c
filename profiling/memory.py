"""Memory that a job takes from mesh to proof, stage by stage, under a limit that the system keeps.

    python profiling/memory.py --n 512 --angles 360 --evaluations 20 --memory 4GB --device opencl:pocl:0

The process may have so much private memory and no more (RLIMIT_DATA, by which Linux refuses what goes beyond); pages of
mapped files, which the system takes back when it needs them, do not count. Peaks are of resident private memory.
"""

from __future__ import annotations

import argparse
import json
import resource
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

from common import machine, write_record

from vamgpu.backend import within
from vamgpu.quantity import bytes_of

JOB = """
[target]
shape = "{shape}"
height = "{height} mm"
pitch = "{pitch} mm"

[beam]
pixels = [{across}, {high}]
pitch = "{pitch} mm"

[turntable]
angles = {angles}

[vial]
radius = "12.4 mm"
wall = "1.0 mm"
resin_index = 1.49962
wall_index = 1.473
absorption = "0.05 1/mm"

[solve]
method = "{method}"
iterations = {iterations}
evaluations = {evaluations}
operator = "{operator}"
device = "{device}"

[print]
irradiance = "65 mW/cm2"
critical_dose = "50 mJ/cm3"
"""
WIDTH = 14.8
"""Of the grid [mm]; light as wide as 1.5 of it in the air crosses all of it at every angle."""


def private() -> int:
    """Resident private memory [bytes]."""
    for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
        if line.startswith("RssAnon:"):
            return int(line.split()[1]) * 1024
    raise OSError("the system does not tell RssAnon")


def _times(row: dict[str, float]) -> str:
    """Of a stage."""
    return f"{row['seconds']:.1f} s ({row['processor_seconds']:.1f} s of processors), {row.get('peak_GB', 0.0):.2f} GB"


class Watch:
    """Peaks and seconds by stage."""

    def __init__(self) -> None:
        self.rows: dict[str, dict[str, float]] = {}
        self.stage, self.since, self.worked = "start", time.perf_counter(), time.process_time()
        threading.Thread(target=self._look, daemon=True).start()

    def __call__(self, stage: str, share: float = 0.0) -> None:
        """Take the name of the stage that begins."""
        if stage != self.stage:
            now, worked = time.perf_counter(), time.process_time()
            row = self.rows.setdefault(self.stage, {})
            row["seconds"] = row.get("seconds", 0.0) + now - self.since
            row["processor_seconds"] = row.get("processor_seconds", 0.0) + worked - self.worked
            print(f"{self.stage}: {_times(row)}", file=sys.stderr, flush=True)
            self.stage, self.since, self.worked = stage, now, worked

    def _look(self) -> None:
        while True:
            row, now = self.rows.setdefault(self.stage, {}), private() / 1e9
            row["peak_GB"] = max(row.get("peak_GB", 0.0), now)
            time.sleep(0.02)


def child(asked: argparse.Namespace) -> None:
    """Do the job under the limit, and print the peaks."""
    limit = bytes_of(asked.memory) or 0
    resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))
    watch = Watch()
    from vamgpu.jobs.read import read_job
    from vamgpu.jobs.run import prove, solve
    from vamgpu.printing.export import export
    from vamgpu.printing.folder import load_frames
    from vamgpu.storage.folder import Folder

    place = asked.child
    job = read_job(place / "job.toml", ())
    solve(job, place / "job.vam", progress=lambda stage, share: watch(f"solve: {stage}"))
    if asked.solve_only:
        watch("end")
        return print(json.dumps({"stages": watch.rows}))
    watch("verify")
    Folder.open(place / "job.vam").verify()
    watch("prove")
    proven = prove(place / "job.vam", job.file.solve.device, progress=lambda stage, share: watch(f"prove: {stage}"))
    scores = proven.proof.scores
    if asked.report:
        watch("report")
        proven.report(place / "report.html")
    del proven
    watch("export")
    export(load_frames(place / "job.vam", job.file.solve.device), place / "frames.tiff")
    watch("end")
    filed = sum(path.stat().st_size for path in (place / "job.vam").rglob("*") if path.is_file())
    watch.rows.pop("end", None)
    print(json.dumps({"stages": watch.rows, "window": scores.window, "iou": scores.iou, "folder_bytes": filed}))


def main() -> None:
    """Run a job in a process of its own and write the record."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--n", type=int, default=128)
    options.add_argument("--angles", type=int, default=180)
    options.add_argument("--shape", default="gyroid_sphere")
    options.add_argument("--operator", default="auto", help="voxels, rings, or auto, as in job files")
    options.add_argument("--method", default="default")
    options.add_argument("--iterations", type=int, default=1000)
    options.add_argument("--evaluations", type=float, default=2.0)
    options.add_argument("--memory", default="4GB")
    options.add_argument("--device", default="opencl:pocl:0", help="a processor through OpenCL")
    options.add_argument("--solve-only", action="store_true", help="prove nothing")
    options.add_argument("--report", action="store_true", help="draw the report too")
    options.add_argument("--at", type=Path, default=Path("/var/tmp"))  # noqa: S108 - /tmp may be memory
    options.add_argument("--records", type=Path, default=None)
    options.add_argument("--label", default="here")
    options.add_argument("--child", type=Path, default=None, help=argparse.SUPPRESS)
    asked = options.parse_args()
    if asked.child:
        return child(asked)
    pitch = WIDTH / asked.n
    fields = {
        key: getattr(asked, key) for key in ("angles", "shape", "operator", "method", "iterations", "evaluations")
    }
    device = within(asked.device, asked.memory)
    text = JOB.format(**fields, device=device, pitch=pitch, across=3 * asked.n // 2, high=asked.n,
                      height=(asked.n - 6) * pitch)  # fmt: skip
    folder = Path(tempfile.mkdtemp(dir=asked.at))
    try:
        (folder / "job.toml").write_text(text, encoding="utf-8")
        words = [sys.executable, __file__, *sys.argv[1:], "--child", str(folder)]
        run = subprocess.run(words, stdout=subprocess.PIPE, text=True, check=True)
    finally:
        shutil.rmtree(folder)
    found: dict[str, Any] = json.loads(run.stdout.splitlines()[-1])
    for stage, row in found["stages"].items():
        print(f"{stage}: {_times(row)}")
    if not asked.solve_only:
        print(f"window {found['window']:+.4f}, IoU {found['iou']:.4f}, folder {found['folder_bytes'] / 1e9:.2f} GB")
    if asked.records:
        asks = {key: value for key, value in vars(asked).items() if isinstance(value, (str, int, float))}
        write_record(asked.records, f"memory-{asked.label}-{asked.n}", {"machine": machine(), "asked": asks, **found})


if __name__ == "__main__":
    main()

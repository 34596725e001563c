"""Rates of a job folder against those of its disk: writing, proving by hashes, reading back, exporting.

    python profiling/storage.py --frames 10000 --shape 480 640 --at /var/tmp

Rates are of frames as they are in memory. The disk's own are those of a plain file of as many bytes, written and
brought to the disk, and read again from it; all files are dropped from the system's cache before they are read. What
else bounds a folder that is read is beside them: memory that the system gives, and one thread of SHA-256.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import shutil
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from common import machine, write_record

import vamgpu as vam
from vamgpu.printing.export import export
from vamgpu.printing.folder import load_frames
from vamgpu.printing.frames import Frames
from vamgpu.storage.folder import Entry, Folder, Streamed, write_folder

BLOCK = 1 << 23


def dropped(place: Path) -> None:
    """Let the system forget what it keeps of files."""
    os.sync()
    for path in [place] if place.is_file() else sorted(place.rglob("*")):
        if path.is_file():
            with open(path, "rb") as file:
                os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)


def seconds(run: Callable[[], object], cold: Path | None = None) -> tuple[float, float]:
    """Of a run, once: by the clock, and of all processors."""
    if cold is not None:
        dropped(cold)
    start, busy = time.perf_counter(), time.process_time()
    run()
    return time.perf_counter() - start, time.process_time() - busy


def written(path: Path, count: int) -> None:
    """A file of random blocks, brought to the disk."""
    block = np.random.default_rng(0).bytes(BLOCK)
    with open(path, "wb", buffering=0) as file:
        for first in range(0, count, BLOCK):
            file.write(block[: min(BLOCK, count - first)])
        os.fsync(file.fileno())


def through(path: Path) -> None:
    """Read a file."""
    with open(path, "rb", buffering=0) as file:
        while file.readinto(bytearray(BLOCK)):
            pass


def hashed(block: bytes, count: int) -> None:
    """Hash so many bytes, as many at once as are in a block."""
    seal = hashlib.sha256()
    for first in range(0, count, len(block)):
        seal.update(block[: min(len(block), count - first)])


def picture(shape: tuple[int, int], number: int) -> np.ndarray:
    """A frame with gradients, edges and grain, as optimized light has."""
    row, column = np.mgrid[: shape[0], : shape[1]]
    smooth = np.sin(column / 31 + number / 7) * np.cos(row / 43 + number / 11)
    grain = np.random.default_rng(number).normal(0.0, 2.0, shape)
    lit = np.abs(column - shape[1] / 2) < 0.3 * shape[1]
    return np.where(lit, np.clip(128 + 100 * smooth + grain, 0, 255), 0).astype(np.uint8)


def main() -> None:
    """Time everything and write the record."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--frames", type=int, default=2000)
    options.add_argument("--shape", type=int, nargs=2, default=(480, 640), help="rows and columns")
    options.add_argument("--at", type=Path, default=Path("/var/tmp"))  # noqa: S108 - /tmp may be memory
    options.add_argument("--formats", nargs="*", default=["tiff", "npz", "png", "mp4"])
    options.add_argument("--records", type=Path, default=None)
    options.add_argument("--label", default="here")
    asked = options.parse_args()
    shape, few = tuple(asked.shape), min(asked.frames, 64)
    some = np.stack([picture(shape, number) for number in range(few)])
    count = asked.frames * some[0].nbytes
    rows: dict[str, dict[str, Any]] = {}

    def told(what: str, took: tuple[float, float], beside: str | None = None) -> None:
        rate = count / took[0] / 1e6
        rows[what] = {"seconds": took[0], "processor_seconds": took[1], "MB_s": rate}
        share = "" if beside is None else f", {rate / rows[beside]['MB_s']:.2f} of the disk's"
        print(f"{what}: {took[0]:.2f} s ({took[1]:.2f} of processors), {rate:.0f} MB/s{share}", flush=True)

    values = Streamed((asked.frames, *shape), some.dtype,
                      lambda first, last: some[np.arange(first, last) % few])  # fmt: skip
    with tempfile.TemporaryDirectory(dir=asked.at) as folder:
        at = Path(folder)
        told("disk, writing", seconds(lambda: written(at / "plain", count)))
        told("disk, reading", seconds(lambda: through(at / "plain"), at / "plain"))
        (at / "plain").unlink()
        told("memory, taken anew", seconds(lambda: np.empty(count, np.uint8).fill(1)), "disk, reading")
        block = some[0].tobytes() * few
        told("SHA-256 in one thread", seconds(lambda: hashed(block, count)), "disk, reading")
        job = at / "job.vam"
        details = {"frames": {"bits": 8, "columns": shape[1], "scale": 1.0, "gray": vam.GrayCurve.linear().describe(),
                              "settings": {"flip_r": False, "flip_z": False, "shift": [0.0, 0.0]}}}  # fmt: skip
        axes = ("angle", "row", "column")
        kinds = {"inputs": {}, "details": details, "device": "numpy"}
        took = seconds(lambda: write_folder(job, {"frames": Entry(values, axes)}, **kinds))
        told("folder, written", took, "disk, writing")
        kept = sum(path.stat().st_size for path in job.rglob("*") if path.is_file())
        print(f"{count / 1e9:.2f} GB of frames in {kept / 1e9:.2f} GB of files")
        told("folder, proven by hashes", seconds(lambda: Folder.open(job).verify(), job), "disk, reading")
        frames: list[Frames] = []
        told("folder, loaded", seconds(lambda: frames.append(load_frames(job, "numpy")), job), "disk, reading")
        for name in asked.formats:
            place = at / ("pictures" if name == "png" else f"film.{name}")
            told(f"exported to {name}", seconds(lambda p=place: export(frames[0], p)), "disk, writing")
            shutil.rmtree(place) if place.is_dir() else place.unlink()
    if asked.records:
        record = {"machine": machine(), "frames": asked.frames, "shape": shape, "stored": kept, "rows": rows}
        write_record(asked.records, f"storage-{asked.label}", record)


if __name__ == "__main__":
    main()

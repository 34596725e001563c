"""Patterns of other programs made into jobs, to prove, print or optimize further."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from vamgpu.backend import open_device
from vamgpu.errors import BadInput, JobError, StorageError
from vamgpu.geometry import Turntable
from vamgpu.jobs.build import motion_of, packing_of, projection_of, target_of, with_diffusion
from vamgpu.jobs.foreign.drtvam import read_drtvam, read_task
from vamgpu.jobs.foreign.patterns import ForeignPatterns
from vamgpu.jobs.foreign.pictures import Layout, read_pictures
from vamgpu.jobs.foreign.vamtoolbox import ENDINGS, read_vamtoolbox
from vamgpu.jobs.keys import toml_text
from vamgpu.jobs.model import JobFile
from vamgpu.jobs.read import Job, read_text
from vamgpu.jobs.run import StageProgress, quiet
from vamgpu.printing.folder import save_frames
from vamgpu.printing.pack import Solved, pack
from vamgpu.storage.atomic import replacing
from vamgpu.storage.films import FORMATS
from vamgpu.storage.folder import Folder, check_place
from vamgpu.storage.reading import load_toml

VESSELS = ("vial", "vat", "vessel", "light")


@dataclass(frozen=True)
class Imported:
    folder: Folder
    program: str
    notes: tuple[str, ...]


def import_patterns(
    source: str | Path,
    path: str | Path,
    *,
    job: str | Path | None = None,
    settings: Iterable[str] = (),
    patterns: str | Path | None = None,
    target: str | Path | None = None,
    layout: Layout = Layout(),
    device: str | None = None,
    overwrite: bool = False,
    progress: StageProgress = quiet,
) -> Imported:
    """Convert another program's patterns to a job folder for ``vam prove``."""
    place, origin = Path(path), Path(source)
    check_place(place, overwrite=overwrite)
    progress("patterns", 0.0)
    found = found_in(origin, None if patterns is None else Path(patterns), None if target is None else Path(target),
                     layout)  # fmt: skip
    folder = Path(job).parent if job is not None else origin.parent
    own: dict[str, Any] = {}
    if job is not None:
        read_text(job)  # raises the same error as for a missing job file
        own = load_toml(job, "the job file", missing=JobError, wrong=JobError)
    try:
        checked = Job.of(_merged(found.tables, own), settings, folder=folder, name=origin.stem)
    except JobError as error:
        if job is not None:
            raise
        raise JobError(f"{str(source)!r} lacks keys of a job; add a job file with part and pixels: --job job.toml"
                       f"\n{error}") from error  # fmt: skip
    there = open_device(device or checked.file.solve.device)
    motion = _motion(checked.file, found, own, folder, source)
    file = _with_pixels(checked.file, found, source)
    progress("voxels", 0.0)
    part = target_of(checked, there) if found.target is None or "target" in own else found.target(file, there)
    A = with_diffusion(file, projection_of(file, part, there, folder, motion), folder)
    progress("frames", 0.0)
    most = float(np.max(found.light))
    if not most > 0.0:
        raise BadInput(f"every pattern of {str(source)!r} is dark; expected some light")
    packing: dict[str, Any] = packing_of(file.frames, folder) | {"scale": most if found.full is None else found.full}
    packing["dither"] = packing["dither"] or "round"  # as the other program rounds
    frames = pack(Solved(there.upload(found.light), A, part), **packing)
    progress("folder", 0.0)
    inputs = {
        "job": checked.given,
        "print": None if file.print is None else file.print.model_dump(),
        "imported": {"program": found.program, "source": origin.name, "notes": list(found.notes)},
    }
    return Imported(save_frames(place, frames, inputs=inputs, overwrite=overwrite), found.program, found.notes)


def _with_pixels(file: JobFile, found: ForeignPatterns, source: str | Path) -> JobFile:
    """A job with the pixels of patterns. Raises `BadInput` if the job has others."""
    _, columns, rows = found.light.shape
    if file.beam.pixels not in (None, (columns, rows)):
        raise BadInput(f"{str(source)!r} has patterns of {columns} × {rows} pixels, but the job's beam has "
                       f"{file.beam.pixels}; leave beam.pixels out")  # fmt: skip
    return file.model_copy(update={"beam": file.beam.model_copy(update={"pixels": (columns, rows)})})


def _motion(file: JobFile, found: ForeignPatterns, own: dict[str, Any], folder: Path, source: str | Path) -> Turntable:
    """Angles of patterns; those of the job's ``own`` tables take precedence. Raises `BadInput`, `JobError`."""
    count = found.light.shape[0]
    motion = motion_of(file.turntable.model_copy(update={"angles": file.turntable.angles or count}), folder)
    if motion.angles != count:
        raise BadInput(f"{str(source)!r} has patterns for {count} angles, but the job has {motion.angles}; expected "
                       "the same number: leave out [turntable], or set the angle of each pattern")  # fmt: skip
    if found.motion is None or "range" in own.get("turntable", {}) or isinstance(file.turntable.angles, str):
        return motion
    if "lit_share" not in own.get("turntable", {}):
        return found.motion
    return Turntable(found.motion.theta or found.motion.angles, found.motion.dwell, file.turntable.lit_share)


def import_task(source: str | Path, path: str | Path, *, overwrite: bool = False) -> tuple[str, ...]:
    """Write a job file for ``vam solve`` from another program's configuration, with the part beside it."""
    origin, place = Path(source), Path(path)
    if origin.suffix.lower() != ".json":
        raise BadInput(f"a job file is made from a configuration of Dr.TVAM or a preset of VAMToolbox, both in JSON, "
                       f"but {str(source)!r} is not one; import patterns into a folder: --out job.vam")  # fmt: skip
    tables, bodies, notes = read_task(origin)
    names = [f"{place.stem}-{f'insert{k}' if k else 'part'}.ply" for k in range(len(bodies))]
    for taken in (place, *map(place.with_name, names)):
        if os.path.lexists(taken) and not overwrite:
            raise StorageError(f"{str(taken)!r} exists; choose another path, or allow overwriting it (--overwrite)")
    for name, (_, solid) in zip(names, bodies, strict=True):
        solid.save(place.with_name(name))
    body = [{"mesh": name, **keys} for name, (keys, _) in zip(names, bodies, strict=True)]
    with replacing(place, overwrite=overwrite) as draft:
        draft.write_text(toml_text({"body": body, **tables}), encoding="utf-8")
    return notes


def found_in(
    source: Path, patterns: Path | None = None, target: Path | None = None, layout: Layout = Layout()
) -> ForeignPatterns:
    """Patterns in a file or folder of another program; arguments and errors as for `import_patterns`."""
    ending = source.suffix.lower()
    images = source.is_dir() or ending in (*FORMATS, ".npz")
    if target is not None and ending not in ENDINGS:
        raise BadInput(f"--target is for a sinogram of VAMToolbox, but {str(source)!r} is not one; leave it out")
    if patterns is not None and ending != ".json":
        raise BadInput(f"--patterns is for a configuration of Dr.TVAM, but {str(source)!r} is not one; import the "
                       "patterns themselves, with a job")  # fmt: skip
    if layout.tvam_code and not images:
        raise BadInput(f"--for is for images, but {str(source)!r} is a file of another program; leave it out")
    if not source.exists():
        raise StorageError(f"there is no {str(source)!r}; check the path")
    if images:
        return read_pictures(source, layout)
    if ending == ".json":
        return read_drtvam(source, patterns)
    if ending in ENDINGS:
        return read_vamtoolbox(source, target)
    known = ", ".join((".json", *ENDINGS, ".npz", *FORMATS))
    raise BadInput(f"cannot import {str(source)!r}: expected a folder of images, or a file ending in {known}")


def _merged(found: dict[str, Any], own: dict[str, Any]) -> dict[str, Any]:
    """Tables of a source and of a job, merged; the part and the vessel of the job take precedence."""
    kept = {name: table for name, table in found.items() if name not in VESSELS or not set(own) & set(VESSELS)}
    part = own.get("target")
    if isinstance(part, dict) and "target" in kept:
        kept["target"] = {"pitch": kept["target"]["pitch"]} if "pitch" in kept["target"] else {}
    merged = {**kept, **own}
    for name in set(kept) & set(own):
        if isinstance(kept[name], dict) and isinstance(own[name], dict):
            merged[name] = {**kept[name], **own[name]}
    return merged

"""Patterns of other programs made into jobs that are proven, printed and solved on."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from vamgpu.backend import open_device
from vamgpu.errors import BadInput, JobError, StorageError
from vamgpu.jobs.build import motion_of, packing_of, projection_of, target_of, with_diffusion
from vamgpu.jobs.foreign.drtvam import read_drtvam, read_task
from vamgpu.jobs.foreign.found import Found
from vamgpu.jobs.foreign.pictures import Layout, read_pictures
from vamgpu.jobs.foreign.vamtoolbox import ENDINGS, read_vamtoolbox
from vamgpu.jobs.keys import toml_text
from vamgpu.jobs.read import Job, read_text
from vamgpu.jobs.run import StageProgress, _quietly
from vamgpu.storage.atomic import replacing
from vamgpu.storage.films import FORMATS
from vamgpu.storage.folder import Folder
from vamgpu.storage.reading import load_toml

VESSELS = ("vial", "vat", "vessel", "light")


@dataclass(frozen=True)
class Imported:
    """A job that was imported.

    Args:
        folder: Its folder.
        program: Whose patterns they are.
        notes: What was left out or assumed.
    """

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
    progress: StageProgress = _quietly,
) -> Imported:
    """Make a job of another program's patterns, whose folder ``vam prove`` judges by this library's proof.

    Args:
        source: A configuration of Dr.TVAM in JSON, a sinogram of VAMToolbox (``.sino``, or an array [r, angle, z] as
            ``.npy``), a folder of PNG, TIFF or EXR images, or a film, as OpenCAL plays them.
        path: The folder to write.
        job: TOML file of what the source does not say, such as part, vessel and pixels; it goes before what the source
            says.
        settings: ``key=value`` that go before both.
        patterns: Of Dr.TVAM, where they are not beside the configuration.
        target: Voxels that VAMToolbox solved for (``.target``, or an array [y, x, z]), in place of a mesh in the job.
        layout: How images lie that do not say it themselves.
        device: Where to compute; the best one here by default.
        overwrite: Replace a job folder that stands there.
        progress: Is told the stage and its share that is done.

    Returns:
        The job.

    Raises:
        StorageError: A file is missing or damaged, or would run code.
        BadInput: A file says what this library has no model of, or source and job do not go together.
        JobError: A key of the job is missing or wrong.
        MeshError: The mesh cannot be used.
    """
    from vamgpu.printing.folder import save_frames
    from vamgpu.printing.pack import Solved, pack

    place, origin = Path(path), Path(source)
    if os.path.lexists(place) and not overwrite:
        raise StorageError(f"{str(path)!r} exists; choose another path, or allow overwriting it (--overwrite)")
    progress("patterns", 0.0)
    found = found_in(origin, None if patterns is None else Path(patterns), None if target is None else Path(target),
                     layout)  # fmt: skip
    folder = Path(job).parent if job is not None else origin.parent
    own: dict[str, Any] = {}
    if job is not None:
        read_text(job)  # raises what a missing job file raises
        own = load_toml(job, "the job file", missing=JobError, wrong=JobError)
    wanted = Job.of(_merged(found.tables, own), settings, folder=folder, name=origin.stem)
    file, there = wanted.file, open_device(device or wanted.file.solve.device)
    count, columns, rows = found.light.shape
    motion = (
        motion_of(file.turntable, folder)
        if found.motion is None or "range" in own.get("turntable", {})
        else found.motion
    )
    if motion.angles != count:
        raise BadInput(f"{str(source)!r} has patterns for {count} angles, the job {motion.angles}; expected as many: "
                       "leave [turntable] out, or name the angles of each")  # fmt: skip
    if file.beam.pixels not in (None, (columns, rows)):
        raise BadInput(f"{str(source)!r} has patterns of {columns} × {rows} pixels, the job's beam {file.beam.pixels}; "
                       "leave beam.pixels out")  # fmt: skip
    beam = file.beam.model_copy(update={"pixels": (columns, rows)})
    file = file.model_copy(update={"beam": beam})
    progress("voxels", 0.0)
    part = target_of(wanted, there) if found.target is None or "target" in own else found.target(file, there)
    A = with_diffusion(file, projection_of(file, part, there, folder, motion), folder)
    progress("frames", 0.0)
    most = float(np.max(found.light))
    if not most > 0.0:
        raise BadInput(f"every pattern of {str(source)!r} is dark; expected some light")
    packing: dict[str, Any] = packing_of(file.frames, folder) | {"scale": most if found.full is None else found.full}
    frames = pack(Solved(there.upload(found.light), A, part), **packing)
    progress("folder", 0.0)
    inputs = {
        "job": wanted.given,
        "print": None if file.print is None else file.print.model_dump(),
        "imported": {"program": found.program, "source": origin.name, "notes": list(found.notes)},
    }
    return Imported(save_frames(place, frames, inputs=inputs, overwrite=overwrite), found.program, found.notes)


def import_task(source: str | Path, path: str | Path, *, overwrite: bool = False) -> tuple[str, ...]:
    """Make a job file of what another program was to solve, for ``vam solve``; the part is written beside it.

    Args:
        source: A configuration of Dr.TVAM in JSON; patterns are not needed.
        path: The job file, ending in .toml; ``boat.toml`` gets its part in ``boat-part.ply``.
        overwrite: Replace both.

    Returns:
        What was left out.

    Raises:
        StorageError: A file is missing or damaged, or one of those to be written exists.
        BadInput: The source says what this library has no model of, or is no configuration.
        MeshError: The mesh cannot be used.
    """
    origin, place = Path(source), Path(path)
    if origin.suffix.lower() != ".json":
        raise BadInput(f"a job file is made of a configuration of Dr.TVAM in JSON, and {str(source)!r} is none; import "
                       "patterns into a folder: --out job.vam")  # fmt: skip
    mesh = place.with_name(f"{place.stem}-part.ply")
    for taken in (place, mesh):
        if os.path.lexists(taken) and not overwrite:
            raise StorageError(f"{str(taken)!r} exists; choose another path, or allow overwriting it (--overwrite)")
    tables, part, notes = read_task(origin)
    with replacing(mesh, overwrite=overwrite) as draft:
        part.save(draft)
    with replacing(place, overwrite=overwrite) as draft:
        draft.write_text(toml_text({"body": [{"mesh": mesh.name}], **tables}), encoding="utf-8")
    return notes


def found_in(
    source: Path, patterns: Path | None = None, target: Path | None = None, layout: Layout = Layout()
) -> Found:
    """What a file or folder of another program holds; arguments and errors as for `import_patterns`."""
    ending = source.suffix.lower()
    if target is not None and ending not in ENDINGS:
        raise BadInput(
            f"voxels are taken beside a sinogram of VAMToolbox, and {str(source)!r} is none; leave --target out"
        )
    if patterns is not None and ending != ".json":
        raise BadInput(f"patterns are named beside a configuration of Dr.TVAM, and {str(source)!r} is none; import "
                       "them themselves, with a job")  # fmt: skip
    if source.is_dir() or ending in FORMATS:
        return read_pictures(source, layout)
    if ending == ".json":
        return read_drtvam(source, patterns)
    if ending in ENDINGS:
        return read_vamtoolbox(source, target)
    if not source.exists():
        raise StorageError(f"there is no {str(source)!r}; check the path")
    known = ", ".join((".json", *ENDINGS, *FORMATS))
    raise BadInput(f"cannot import {str(source)!r}: expected a folder of images, or a file ending in {known}")


def _merged(found: dict[str, Any], own: dict[str, Any]) -> dict[str, Any]:
    """Tables of a source under those of a job, whose part and whose vessel take the place of the source's."""
    kept = {name: table for name, table in found.items() if name not in VESSELS or not set(own) & set(VESSELS)}
    part = own.get("target")
    if isinstance(part, dict) and "target" in kept:
        kept["target"] = {"pitch": kept["target"]["pitch"]} if "pitch" in kept["target"] else {}
    merged = {**kept, **own}
    for name in set(kept) & set(own):
        if isinstance(kept[name], dict) and isinstance(own[name], dict):
            merged[name] = {**kept[name], **own[name]}
    return merged

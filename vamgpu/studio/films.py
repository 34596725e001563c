"""Webs for the page: the machine in section, and the frames with their focus planes."""

from __future__ import annotations

from typing import Any

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.geometry import Beam
from vamgpu.jobs.web import WebFile
from vamgpu.optics.roller import Roller
from vamgpu.storage.reading import malformed
from vamgpu.studio.tasks import POINTS
from vamgpu.studio.workspace import Refused
from vamgpu.webs.describe import wrap_from
from vamgpu.webs.section import focus_masks
from vamgpu.webs.store import WebFolder


def machine_of(file: WebFile) -> dict[str, Any]:
    """The machine of a job: lengths in mm about the roller's axis, with light travelling towards +y."""
    roller = file.roller(film=file.film)
    beam = roller.beam(file.beam.pitch, max(1, round(file.beam.height / file.beam.pitch)))
    masks = focus_masks(None if file.lens is None else file.lens(index=file.film.bath_index), roller, beam)
    return _section(roller, beam, roller.planes or () if masks is None else masks.planes) | {
        "length": file.web.length, "speed": file.web.speed}  # fmt: skip


def _section(roller: Roller, beam: Beam, planes: Any) -> dict[str, Any]:
    return {
        "radius": roller.radius, "outer": roller.outer, "leg": roller.leg, "thickness": roller.film.thickness,
        "step": float(np.degrees(roller.step)), "advance": roller.advance, "planes": list(planes),
        "beam": [beam.pixels[0] * beam.pitch, beam.pixels[1] * beam.pitch],
    }  # fmt: skip


def described(folder: WebFolder) -> dict[str, Any]:
    """The machine, the segments and the frames of a folder. Raises `StorageError`."""
    details = folder.details
    with malformed(f"the web {folder.path.name!r} is malformed", "write it again"):
        roller, beam = wrap_from(details["wrap"]), details["beam"]
        focus, along = details["frames"]["focus"], float(details["grid"]["pitch"][0])
        planes = [] if focus is None else focus["planes"]
        section = _section(roller, Beam(tuple(beam["pixels"]), beam["pitch"]), planes)  # type: ignore[arg-type]
        window = int(details["layout"]["window"])
        columns, rows = beam["pixels"]
        parts = folder.segments[:: -(-len(folder.segments) // POINTS) or 1]
        segments = [{"frames": list(each.frames), "mm": [along * column for column in each.columns],
                     "loss": each.loss[1], "saturated": each.saturated} for each in parts]  # fmt: skip
    web = section | {"length": along * folder.columns, "speed": details.get("speed"), "window": along * window,
                     "complete": folder.complete, "segments": segments}  # fmt: skip
    return {"web": web, "frames": {"count": folder.frames, "rows": rows, "columns": columns, "bits": 8,
                                   "scale": details["frames"]["scale"], "step": section["advance"]}}  # fmt: skip


def frame(folder: WebFolder, index: int, plane: int | None) -> np.ndarray:
    """A frame, or the columns of it that one focus plane shows. Raises `Refused`."""
    if index >= folder.frames:
        raise Refused(400, f"got frame {index}; expected 0 to {folder.frames - 1}")
    image, focus = folder.frame(index), folder.details["frames"]["focus"]
    if plane is None:
        return image
    if focus is None or plane >= len(focus["planes"]):
        count = 0 if focus is None else len(focus["planes"])
        raise BadInput(f"got focus plane {plane}; this web has {count}: leave it out")
    return np.where(np.array(focus["bin"]) == plane, image, 0).astype(np.uint8)

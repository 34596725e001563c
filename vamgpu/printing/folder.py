"""Frames in job folders: everything that `simulate` and a projector need, and the origin of the frames."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from vamgpu.backend import open_device
from vamgpu.backend.device import Device
from vamgpu.errors import BadInput
from vamgpu.methods.plan import Plan
from vamgpu.methods.plan_folder import inputs_of, light_of, pixel_pitch, plan_described, sinogram_from
from vamgpu.printing.frames import Frames
from vamgpu.printing.gray import GrayCurve
from vamgpu.printing.pack import Solved, pack
from vamgpu.printing.placement import FIT, Placement
from vamgpu.storage.folder import Entry, Folder, write_folder
from vamgpu.storage.reading import malformed
from vamgpu.storage.turntable import described, turntable_from


def save_frames(
    path: str | Path,
    frames: Frames,
    *,
    inputs: Mapping[str, Any] | None = None,
    arrays: Mapping[str, Entry] | None = None,
    details: Mapping[str, Any] | None = None,
    overwrite: bool = False,
) -> Folder:
    """Write frames to a job folder: Zarr arrays, one chunk per frame, and ``manifest.json``."""
    # Frames of a plan are stored as its float32 patterns and the packing settings: a calibrated machine can then pack
    # the patterns itself. Other frames are stored as bytes. inputs: settings of the job, kept in the manifest; by
    # default geometry, target and record of the frames' plan. arrays: further arrays to store. details: of those.
    plan, own = frames.plan, {}
    known: dict[str, Any] = {}
    record: dict[str, Any] = {"saved": "frames", "frames": describe(frames)}
    if plan is None:
        columns = "column" if frames.bits == 8 else "byte"
        entries = {"frames": Entry(frames.images, ("angle", "row", columns))}
    else:
        entries = {"frames": Entry(light_of(plan.sinogram), ("angle", "row", "column"), spacing=pixel_pitch(plan))}
        if "geometry" not in (inputs or {}) and getattr(plan, "operator", None) is not None:
            try:
                known, own = inputs_of(plan)
            except BadInput as error:  # they can be printed, but not proved
                known = {"undescribed": str(error)}
        if isinstance(plan, Plan):
            record["plan"], own_arrays = plan_described(plan)
            entries |= own_arrays
    if frames.flat_field is not None:
        entries["flat_field"] = Entry(frames.flat_field, ("row", "column"))
    taken = set(entries) & set(arrays or {})
    if taken:
        raise BadInput(f"the names {', '.join(sorted(taken))} are those of the frames' own arrays; choose other names")
    return write_folder(
        path,
        {**own, **entries, **(arrays or {})},
        inputs={**known, **(inputs or {})},
        details={**record, **(details or {})},
        device=f"{frames.device.name} ({frames.device.description})",
        overwrite=overwrite,
    )


def load_frames(path: str | Path, device: str | Device | None = None) -> Frames:
    """Frames of a job folder, verified by their hashes, on a device. Raises `StorageError`."""
    return frames_of(Folder.open(path), open_device(device))


def frames_of(folder: Folder, place: Device, plan: Any = None) -> Frames:
    """Frames of an open job folder; patterns are packed with stored settings, or with the defaults of `pack`."""
    name, flat = str(folder.path), None
    stored = folder.record("frames")
    packed = stored.dtype == "uint8"
    with malformed(f"the frames in the manifest of {name!r} are malformed", "write the job again"):
        details = folder.manifest.details["frames"]
        poses = details.get("turntable")  # folders of earlier versions do not record it
        motion = None if poses is None else turntable_from(poses)
        settings, gray, known = Placement(), GrayCurve.linear(), {"bits": 8}
        if packed or "bits" in details:
            settings = Placement(**{**details["settings"], "shift": tuple(details["settings"]["shift"])})
            known: dict[str, Any] = {key: details[key] for key in ("bits", "scale")}
            gray = GrayCurve.parse(details["gray"])
    if "flat_field" in folder.manifest.arrays:
        flat = folder.array("flat_field")
    with malformed(f"the frames of {name!r} do not fit its manifest", "write it again"):
        if packed:
            images = place.gather(stored.shape, folder.parts("frames"), table=True)
            return Frames(images, gray=gray, settings=settings, flat_field=flat, motion=motion,
                          columns=details.get("columns"), **known)  # fmt: skip
        source = plan or Solved(sinogram_from(folder, place), None)
        how = asdict(settings) | known
        if settings.dither == FIT:
            how["dither"] = "round"  # the patterns round to the chosen pixels
        made = pack(Solved(source.sinogram, None), gray=gray, flat_field=flat, **how)
        return replace(made, settings=settings, motion=motion, packed=(made.images, source))


def describe(frames: Frames) -> dict[str, Any]:
    """Plain values that, with the bytes, define the light of frames."""
    angles, rows, columns = frames.shape
    poses = {} if frames.motion is None else {"turntable": described(frames.motion)}
    return {
        **poses,
        "bits": frames.bits,
        "angles": angles,
        "rows": rows,
        "columns": columns,
        "scale": frames.scale,
        "gray": frames.gray.describe(),
        "settings": {**asdict(frames.settings), "shift": list(frames.settings.shift)},
        "orientation": "row 0 is the largest z, column 0 the smallest r, before flips; 1-bit: highest bit leftmost",
    }

"""Frames in job folders: everything `simulate` and a projector need, and where it came from."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from vamgpu.backend.device import Device
from vamgpu.errors import BadInput, StorageError
from vamgpu.printing.frames import Frames
from vamgpu.printing.gray import GrayCurve
from vamgpu.printing.placement import Placement
from vamgpu.storage.folder import Entry, Folder, write_folder
from vamgpu.storage.turntable import described, turntable_from


def save_frames(
    path: str | Path,
    frames: Frames,
    *,
    inputs: Mapping[str, Any] | None = None,
    arrays: Mapping[str, Entry] | None = None,
    overwrite: bool = False,
) -> Folder:
    """Write frames to a job folder: Zarr arrays, one chunk a frame, and ``manifest.json``.

    inputs: what the job was asked for, kept in the manifest.  arrays: others to keep beside the frames, such as target
    and sinogram.  Raises `StorageError` (nothing is left then), `BadInput`.
    """
    columns = "column" if frames.bits == 8 else "byte"
    entries = {"frames": Entry(frames.images, ("angle", "row", columns))}
    if frames.flat_field is not None:
        entries["flat_field"] = Entry(frames.flat_field, ("row", "column"))
    taken = set(entries) & set(arrays or {})
    if taken:
        raise BadInput(f"the names {', '.join(sorted(taken))} are the frames' own; name the other arrays differently")
    return write_folder(
        path,
        {**entries, **(arrays or {})},
        inputs=inputs or {},
        details={"frames": describe(frames)},
        device=f"{frames.device.name} ({frames.device.description})",
        overwrite=overwrite,
    )


def load_frames(path: str | Path, device: str | Device | None = None) -> Frames:
    """Frames of a job folder, proven by their hashes, on a device. Raises `StorageError`."""
    folder = Folder.open(path)
    try:
        details = folder.manifest.details["frames"]
        settings = Placement(**{**details["settings"], "shift": tuple(details["settings"]["shift"])})
        known: dict[str, Any] = {key: details[key] for key in ("bits", "scale", "columns")}
        gray = GrayCurve.parse(details["gray"])
        poses = details.get("turntable")  # folders of earlier versions do not say
        known["motion"] = None if poses is None else turntable_from(poses)
    except (KeyError, TypeError, BadInput) as error:
        raise StorageError(f"the manifest of {str(path)!r} garbles its frames: {error}; write the job again") from error
    flat = folder.array("flat_field") if "flat_field" in folder.manifest.arrays else None
    try:
        return Frames.from_bytes(
            folder.array("frames"), device, gray=gray, settings=settings, flat_field=flat, **known
        )
    except BadInput as error:
        raise StorageError(f"the frames of {str(path)!r} do not fit its manifest: {error}; write it again") from error


def describe(frames: Frames) -> dict[str, Any]:
    """What it takes, beside the bytes, to know the light of frames; plain values."""
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
        "settings": {
            "flip_r": frames.settings.flip_r,
            "flip_z": frames.settings.flip_z,
            "shift": list(frames.settings.shift),
            "quantile": frames.settings.quantile,
            "dither": frames.settings.dither,
        },
        "orientation": "row 0 is the largest z, column 0 the smallest r, before flips; 1-bit: highest bit leftmost",
    }

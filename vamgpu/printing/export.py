"""Frames as pictures and films other programs read; every format keeps every bit."""

from __future__ import annotations

import json
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vamgpu.errors import BadInput, StorageError
from vamgpu.geometry import positive
from vamgpu.printing.folder import describe
from vamgpu.storage.atomic import replacing
from vamgpu.storage.manifest import plain

if TYPE_CHECKING:
    from vamgpu.printing.frames import Frames


def export(frames: Frames, path: str | Path, *, fps: float = 30.0, overwrite: bool = False) -> Path:
    """Write frames in the format that the path's ending names, and return the path.

    none: a folder of PNG pictures ``frame_0000.png``… and ``frames.json``; ``.tif``, ``.tiff``: one page a frame;
    ``.npz``: the bytes, levels' light and settings; ``.mp4``: lossless H.264 of ``fps`` frames a second. 1-bit frames
    become black and white pictures. All appear whole or not at all; a folder is not overwritten. Raises `BadInput`,
    `StorageError`.
    """
    place = Path(path)
    writer = FORMATS.get(place.suffix.lower())
    if writer is None:
        raise BadInput(f"cannot export {place.name!r}: expected .tif, .tiff, .npz, .mp4, or no ending for a PNG folder")
    if overwrite and place.is_dir():
        raise StorageError(f"{str(path)!r} is a folder; remove it or choose another path")
    rate = positive("frames per second", fps)
    with replacing(place, overwrite=overwrite) as draft:
        writer(frames, draft, rate)
    return place


def _png(frames: Frames, draft: Path, fps: float) -> None:
    from PIL import Image

    draft.mkdir()
    pictures = frames.pictures()
    digits = max(4, len(str(len(pictures) - 1)))
    for index, picture in enumerate(pictures):
        image = Image.fromarray(picture)
        image = image if frames.bits == 8 else image.convert("1")
        image.save(draft / f"frame_{index:0{digits}d}.png")
    (draft / "frames.json").write_text(json.dumps(plain(describe(frames)), indent=2) + "\n", encoding="utf-8")


def _tiff(frames: Frames, draft: Path, fps: float) -> None:
    import tifffile

    description = json.dumps(plain(describe(frames)))
    tifffile.imwrite(
        draft, frames.pictures(), photometric="minisblack", compression="zlib", description=description, metadata=None
    )


def _npz(frames: Frames, draft: Path, fps: float) -> None:
    fields = {
        "images": frames.images.numpy(),
        "bits": np.array(frames.bits),
        "columns": np.array(frames.columns),
        "scale": np.array(frames.scale),
        "curve": frames.gray.table(frames.bits),
        "flat_field": np.ones(frames.shape[1:]) if frames.flat_field is None else frames.flat_field,
        "description": np.array(json.dumps(plain(describe(frames)))),
    }
    with open(draft, "wb") as file:  # given a path, NumPy would add an ending of its own to .NPZ
        np.savez_compressed(file, **fields)


def _mp4(frames: Frames, draft: Path, fps: float) -> None:
    import av
    from av.error import FFmpegError

    _, rows, columns = frames.shape
    try:
        with av.open(str(draft), "w", format="mp4") as film:
            rate = Fraction(fps).limit_denominator(1001)
            stream = film.add_stream("libx264", rate=rate, options={"qp": "0", "preset": "fast"})
            stream.width, stream.height, stream.pix_fmt = columns, rows, "gray"
            stream.codec_context.color_range = FULL_RANGE
            for picture in frames.pictures():
                image = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="gray")
                image.color_range = FULL_RANGE
                film.mux(stream.encode(image))
            film.mux(stream.encode())
    except FFmpegError as error:
        if isinstance(error, OSError):
            raise
        raise StorageError(f"cannot encode {draft.name!r}: {error}; export PNG or TIFF instead") from error


FULL_RANGE = 2
"""FFmpeg's number for pixel values from 0 to 255; without it players stretch 16 to 235."""

FORMATS: dict[str, Callable[[Frames, Path, float], None]] = {
    "": _png,
    ".tif": _tiff,
    ".tiff": _tiff,
    ".npz": _npz,
    ".mp4": _mp4,
}

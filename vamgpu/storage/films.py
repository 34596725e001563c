"""Videos, frame by frame: read in gray levels, written in color."""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from vamgpu.errors import StorageError
from vamgpu.storage.atomic import check_folder, explained, replacing
from vamgpu.storage.memory import afford
from vamgpu.storage.reading import open_file

FORMATS = {".mp4": "mov", ".mov": "mov", ".m4v": "mov", ".mkv": "matroska", ".webm": "matroska", ".avi": "avi"}
"""Ending → FFmpeg's format. Formats that refer to other files, such as playlists, are left out."""
MOST_PIXELS = 1 << 26
FULL_RANGE = 2  # FFmpeg's number for levels from 0 to 255; other ranges are 16 to 235
LOW, HIGH = 16, 235


def read_film(path: str | Path) -> tuple[np.ndarray, str]:
    """The frames of a video."""
    import av
    from av.error import FFmpegError

    kind = FORMATS.get(Path(path).suffix.lower())
    if kind is None:
        raise StorageError(f"cannot read {str(path)!r} as a video: expected one ending in {', '.join(FORMATS)}")
    try:
        with open_file(path) as file, av.open(file, "r", format=kind) as film:
            stream = next(iter(film.streams.video), None)
            if stream is None or stream.codec_context is None:
                raise ValueError("it has no images that FFmpeg decodes")
            size = stream.codec_context.width * stream.codec_context.height
            if not 0 < size <= MOST_PIXELS:
                raise ValueError(f"{size:,} pixels per frame, expected at most {MOST_PIXELS:,}")
            frames: list[np.ndarray] = []
            for frame in film.decode(stream):
                afford((len(frames) + 1) * size, f"the video {str(path)!r}")
                frames.append(_gray(frame))
                if frames[-1].shape != frames[0].shape:
                    raise ValueError("its frames have several sizes")
            if not frames:
                raise ValueError("it has no frames")
            return np.stack(frames), str(film.metadata.get("comment", ""))
    except StorageError:
        raise
    except (OSError, ValueError, FFmpegError, EOFError, MemoryError) as error:
        said = getattr(error, "strerror", None) or error
        raise StorageError(f"cannot read {str(path)!r}: {said}; expected a video: export it again") from error


def write_film(path: str | Path, pictures: Iterable[np.ndarray], rate: float) -> Path:
    """Write a video for common players."""
    import av
    from av.error import FFmpegError

    place = Path(path)
    if place.suffix.lower() != ".mp4":
        raise StorageError(f"cannot write {str(place)!r}: expected a video that ends in .mp4")
    check_folder(place)
    try:
        with replacing(place) as draft, av.open(str(draft), "w", format="mp4") as film:
            stream: Any = film.add_stream("libx264", rate=Fraction(rate).limit_denominator(1001), options={"crf": "16"})
            for index, picture in enumerate(pictures):
                even = picture[: len(picture) // 2 * 2, : picture.shape[1] // 2 * 2]
                if index == 0:
                    stream.height, stream.width, stream.pix_fmt = *even.shape[:2], "yuv420p"
                film.mux(stream.encode(av.VideoFrame.from_ndarray(np.ascontiguousarray(even), format="rgb24")))
            film.mux(stream.encode())
    except StorageError:
        raise
    except FFmpegError as error:
        raise StorageError(f"cannot encode {str(place)!r}: {error}") from error
    except OSError as error:
        raise explained("write", place, error) from error
    return place


def _gray(frame: Any) -> np.ndarray:
    """Levels of a frame, 0 to 255, for any range of its brightness."""
    name = frame.format.name
    if not name.startswith(("gray", "yuv", "nv")) or name not in ("gray",) and frame.format.components[0].bits != 8:
        return np.asarray(frame.to_ndarray(format="rgb24")).max(axis=2)  # one channel may be lit alone
    plane = frame.planes[0]
    rows = np.frombuffer(plane, np.uint8).reshape(-1, plane.line_size)[: frame.height, : frame.width]
    if name.startswith("yuvj") or frame.color_range == FULL_RANGE or (name == "gray" and frame.color_range == 0):
        return rows.copy()
    return np.clip(np.rint((rows - float(LOW)) * (255.0 / (HIGH - LOW))), 0, 255).astype(np.uint8)

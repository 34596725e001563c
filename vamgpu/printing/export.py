"""Frames as images and videos for other programs; lossless, except videos that any player decodes."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from itertools import repeat
from pathlib import Path
from typing import TYPE_CHECKING, Any
from zipfile import ZIP_DEFLATED, ZipFile

import numpy as np

from vamgpu.backend.cores import threads
from vamgpu.errors import BadInput, StorageError
from vamgpu.geometry import counts, positive
from vamgpu.printing.folder import describe
from vamgpu.quantity import positive as number
from vamgpu.storage.atomic import as_path, check_folder, replacing
from vamgpu.storage.films import FULL_RANGE, HIGH, LOW
from vamgpu.storage.images import deflated, encode_png
from vamgpu.storage.manifest import plain

if TYPE_CHECKING:
    from vamgpu.printing.frames import Frames

BLOCK = 1 << 25  # bytes of frames that are fetched at once


@dataclass(frozen=True)
class Canvas:
    """The image of a projector, and the position of the frames on it; the rest is black. Raises `BadInput`."""

    size: tuple[int, int] | None = None  # columns and rows; None for those of the frames
    offset: tuple[int, int] = (0, 0)  # shift from the middle: columns to the right, and rows upwards
    rotation: float = 0.0  # counterclockwise [deg]; other than by quarter turns, light is interpolated
    flip_r: bool = False  # left to right, in addition to their own flip
    flip_z: bool = False  # top to bottom, likewise
    repeats: int = 1  # times that the turn is shown
    dark: tuple[int, int] = (0, 0)  # black images before and after
    keystone: tuple[tuple[float, float], ...] | None = None  # left top, right top, right bottom, left bottom

    def __post_init__(self) -> None:
        if self.size is not None:
            object.__setattr__(self, "size", counts("canvas size", self.size, 2))
        counts("canvas repeats", (self.repeats,), 1)
        if min(self.dark) < 0:
            raise BadInput(f"canvas dark is {self.dark!r}; expected numbers of black images before and after")
        if self.keystone is not None:
            if np.shape(self.keystone) != (4, 2):
                raise BadInput(f"canvas keystone is {self.keystone!r}; expected four corners (column, row)")
            object.__setattr__(self, "keystone", tuple((float(x), float(y)) for x, y in self.keystone))
        number("canvas rotation [deg]", abs(self.rotation), zero=True)
        try:
            right, up = (int(part) for part in self.offset)
        except (TypeError, ValueError) as error:
            raise BadInput(f"canvas offset is {self.offset!r}; expected (right, up), two numbers of pixels") from error
        object.__setattr__(self, "offset", (right, up))

    def images(self, frames: Frames) -> Iterator[np.ndarray]:
        """The images, uint8 [row, column], turns between dark ones. Raises `BadInput`, `ShapeMismatch`."""
        each = max(BLOCK // max(frames.shape[1] * frames.shape[2], 1), 1)
        black = np.zeros_like(self._shown(frames.gray_levels(0, 1)[0], frames)) if any(self.dark) else None
        yield from repeat(black, self.dark[0])  # type: ignore[misc]
        for _ in range(self.repeats):
            for first in range(0, frames.shape[0], each):
                for levels in frames.gray_levels(first, min(first + each, frames.shape[0])):
                    yield self._shown(levels, frames)
        yield from repeat(black, self.dark[1])  # type: ignore[misc]

    def undone(self, images: np.ndarray, angles: int, rows: int, columns: int) -> np.ndarray:
        """The levels of the first turn, taken back from images that this canvas exported. Raises `BadInput`."""
        if self.keystone is not None or self.rotation % 90:
            raise BadInput("the images were not rotated by whole quarter turns, or have a keystone; expected plain "
                           "ones: prove the job that they were exported from")  # fmt: skip
        shape = (rows, columns)[:: -1 if round(self.rotation / 90) % 2 else 1]
        top, left = self._corner(shape, images.shape[1:] if self.size is None else self.size[::-1])
        turn = images[self.dark[0] :][:angles, top : top + shape[0], left : left + shape[1]]
        turn = np.rot90(turn, -round(self.rotation / 90), (1, 2))
        turn = turn[:, ::-1] if self.flip_z else turn
        return turn[:, :, ::-1] if self.flip_r else turn

    def _shown(self, levels: np.ndarray, frames: Frames) -> np.ndarray:
        placed = self._placed(self._turned(levels, frames))
        if self.keystone is None:
            return placed
        if frames.bits == 1:
            raise BadInput("frames of 1 bit have no keystone, because a mirror is only on or off: export 8 bits")
        from scipy.ndimage import map_coordinates

        light = frames.gray(placed) - frames.gray.black
        found = map_coordinates(light, _homography(self.keystone, placed.shape), order=1, cval=0.0)
        return frames.gray.inverse(found + frames.gray.black)

    def _turned(self, levels: np.ndarray, frames: Frames) -> np.ndarray:
        levels = levels[:, ::-1] if self.flip_r else levels
        levels = levels[::-1] if self.flip_z else levels
        if self.rotation % 90 == 0:
            return np.rot90(levels, round(self.rotation / 90))
        if frames.bits == 1:
            raise BadInput(f"frames of 1 bit are rotated by {self.rotation:g}°; expected a multiple of 90°, because "
                           "mirrors are only on or off: export 8 bits")  # fmt: skip
        from scipy.ndimage import rotate

        light = np.pad(frames.gray(levels) - frames.gray.black, 1)  # so that no pixel at the rim is lost
        light = rotate(light, self.rotation, reshape=True, order=1)
        return frames.gray.inverse(light + frames.gray.black)

    def _placed(self, levels: np.ndarray) -> np.ndarray:
        if self.size is None and self.offset == (0, 0):
            return np.ascontiguousarray(levels)
        columns, rows = self.size or levels.shape[::-1]
        top, left = self._corner(levels.shape, (rows, columns))
        canvas = np.zeros((rows, columns), np.uint8)
        canvas[top : top + levels.shape[0], left : left + levels.shape[1]] = levels
        return canvas

    def _corner(self, shape: tuple[int, ...], size: tuple[int, ...]) -> tuple[int, int]:
        """Row and column of the canvas at which images of a shape begin. Raises `BadInput` if they do not fit."""
        (rows, columns), (height, width) = shape, size
        top, left = (height - rows) // 2 - self.offset[1], (width - columns) // 2 + self.offset[0]
        if top < 0 or left < 0 or top + rows > height or left + columns > width:
            raise BadInput(
                f"frames of {columns} × {rows} pixels, {self.offset} off the middle, do not fit a canvas of {width} × "
                f"{height}; expected all on the canvas: use a smaller offset or a larger canvas"
            )
        return top, left


@lru_cache(maxsize=2)
def _homography(corners: tuple[tuple[float, float], ...], shape: tuple[int, int]) -> np.ndarray:
    """Row and column of an image that each pixel shows if its corners are drawn there, [2, row, column]."""
    rows, columns = shape
    x, y = np.array([(0, 0), (columns - 1, 0), (columns - 1, rows - 1), (0, rows - 1)], np.float64).T
    known, none = np.concatenate([np.array(corners), np.ones((4, 1))], 1), np.zeros((4, 3))
    equations = np.concatenate([np.concatenate([known, none, -known[:, :2] * x[:, None]], 1),
                                np.concatenate([none, known, -known[:, :2] * y[:, None]], 1)])  # fmt: skip
    if np.linalg.matrix_rank(equations) < 8:
        raise BadInput(f"canvas keystone is {corners!r}; expected four corners of which no three are on a line")
    home = np.append(np.linalg.solve(equations, np.concatenate([x, y])), 1.0).reshape(3, 3)
    column, row = np.meshgrid(np.arange(columns), np.arange(rows))
    at = np.tensordot(home, np.stack([column, row, np.ones_like(row)]), 1)
    return np.stack([at[1], at[0]]) / at[2]


def export(
    frames: Frames, path: str | Path, *, fps: float = 30.0, overwrite: bool = False, canvas: Canvas | None = None,
    players: bool = False, channel: str | None = None,
) -> Path:  # fmt: skip
    """Write frames in the format that the path's ending names.

    No ending: a folder of PNG images ``frame_0000.png``… and ``frames.json``; ``.tif``, ``.tiff``: one page per frame;
    ``.npz``: the bytes, the light of the levels and the settings; ``.mp4``: lossless H.264 in gray, or a video that any
    player decodes. Frames of 1 bit become black and white. Files are written atomically.

    Args:
        frames: The frames.
        path: The file or the new folder, in an existing folder.
        fps: Frames per second of a video [Hz].
        overwrite: Whether to replace a file; folders are never replaced.
        canvas: Position of the frames on a larger image, and number of repeats; not for ``.npz``.
        players: Write a video in yuv420p, which projectors and common players decode, at levels from 16 to 235 and an
            even size; levels change by a few.
        channel: ``"red"``, ``"green"`` or ``"blue"``: a lossless video in RGB that lights this channel alone, which
            players decode in software.

    Returns:
        The path.

    Raises:
        BadInput: The ending is unknown, a number is out of its range, or the frames do not fit the canvas.
        StorageError: The path exists, its folder is missing, or it cannot be written.
    """
    place = as_path(path)
    if not hasattr(frames, "images"):
        raise BadInput(f"got a {type(frames).__name__} to export; expected the frames of vam.pack(plan)")
    writer = FORMATS.get(place.suffix.lower())
    if writer is None:
        raise BadInput(f"cannot export {place.name!r}: expected .tif, .tiff, .npz, .mp4, or no ending for a PNG folder")
    if place.is_dir():
        raise StorageError(f"{str(path)!r} is a folder, which is never replaced; remove it or choose another path")
    check_folder(place)
    if canvas is not None and writer is _npz:
        raise BadInput("an .npz file holds the frames themselves; expected no canvas, rotation, flips or "
                       "repeats: export images or a video with them")  # fmt: skip
    if (players or channel is not None) and writer is not _mp4:
        raise BadInput(f"players read videos, not {place.name!r}; expected a path ending in .mp4")
    if channel is not None and channel not in CHANNELS:
        raise BadInput(f"channel is {channel!r}; expected one of {', '.join(CHANNELS)}")
    how = PLAYERS if players and channel is None else LOSSLESS if channel is None else CHANNELS[channel]
    shown = _Shown(frames, canvas, positive("frames per second", fps), how)
    with replacing(place, overwrite=overwrite) as draft:
        writer(shown, draft)
    return place


@dataclass(frozen=True)
class _Shown:
    """Frames to export, their position, and the settings of a video."""

    frames: Frames
    canvas: Canvas | None
    fps: float
    how: _Film

    @property
    def images(self) -> Iterator[np.ndarray]:
        return (self.canvas or Canvas()).images(self.frames)

    @property
    def count(self) -> int:
        placed = self.canvas or Canvas()
        return self.frames.shape[0] * placed.repeats + sum(placed.dark)

    @property
    def description(self) -> dict[str, Any]:
        """Metadata of the images, for `vam import`."""
        beside: dict[str, Any] = {} if self.canvas is None else {"canvas": self.canvas}
        if self.frames.flat_field is not None:
            beside["flat_field"] = "compensated in the levels, and not kept here"
        return plain({**describe(self.frames), **beside})


def _on_threads(act: Callable[[tuple[int, np.ndarray]], Any], shown: _Shown) -> Iterator[Any]:
    """Results for numbers and images, in order, computed by as many threads as there are cores."""
    with ThreadPoolExecutor(threads()) as pool:
        begun: deque[Future[Any]] = deque()
        for numbered in enumerate(shown.images):
            begun.append(pool.submit(act, numbered))
            if len(begun) > 4 * threads():
                yield begun.popleft().result()
        while begun:
            yield begun.popleft().result()


def _png(shown: _Shown, draft: Path) -> None:
    draft.mkdir()
    digits = max(4, len(str(shown.count - 1)))

    def save(numbered: tuple[int, np.ndarray]) -> None:
        number, levels = numbered
        data = encode_png(levels if shown.frames.bits == 8 else levels > 127)
        (draft / f"frame_{number:0{digits}d}.png").write_bytes(data)

    for _ in _on_threads(save, shown):
        pass
    (draft / "frames.json").write_text(json.dumps(shown.description, indent=2) + "\n", encoding="utf-8")


def _tiff(shown: _Shown, draft: Path) -> None:
    import tifffile

    rows, columns = next(shown.images).shape
    pages = _on_threads(lambda numbered: deflated(numbered[1]), shown)
    tifffile.imwrite(
        draft, pages, shape=(shown.count, rows, columns), dtype=np.uint8, rowsperstrip=rows, photometric="minisblack",
        compression="zlib", description=json.dumps(shown.description), metadata=None,
    )  # fmt: skip


def _npz(shown: _Shown, draft: Path) -> None:
    frames = shown.frames
    fields = {
        "bits": np.array(frames.bits),
        "columns": np.array(frames.columns),
        "scale": np.array(frames.scale),
        "curve": frames.gray.table(frames.bits),
        "flat_field": np.ones(frames.shape[1:]) if frames.flat_field is None else frames.flat_field,
        "description": np.array(json.dumps(plain(describe(frames)))),
    }
    images = frames.images
    each = max(BLOCK // max(images.nbytes // images.shape[0], 1), 1)
    with ZipFile(draft, "w", ZIP_DEFLATED, compresslevel=1) as file:
        with file.open("images.npy", "w", force_zip64=True) as entry:
            head = {"descr": "|u1", "fortran_order": False, "shape": images.shape}
            np.lib.format.write_array_header_1_0(entry, head)  # type: ignore[arg-type]
            for first in range(0, images.shape[0], each):
                entry.write(images.part(first, min(first + each, images.shape[0])).data)
        for name, values in fields.items():
            with file.open(f"{name}.npy", "w", force_zip64=True) as entry:
                np.lib.format.write_array(entry, values, allow_pickle=False)  # type: ignore[arg-type]


def _mp4(shown: _Shown, draft: Path) -> None:
    import av
    from av.error import FFmpegError

    how = shown.how
    try:
        with av.open(str(draft), "w", format="mp4") as film:
            film.metadata["comment"] = json.dumps(shown.description)
            rate = Fraction(shown.fps).limit_denominator(1001)
            stream: Any = film.add_stream(how.codec, rate=rate, options=how.options)
            for index, levels in enumerate(shown.images):
                levels = np.pad(levels, [(0, size % how.even) for size in levels.shape]) if how.even else levels
                if index == 0:
                    stream.height, stream.width = levels.shape
                    stream.pix_fmt, stream.codec_context.color_range = how.pixels, how.range
                film.mux(stream.encode(how.frame(levels)))
            film.mux(stream.encode())
    except FFmpegError as error:
        if isinstance(error, OSError):
            raise
        raise StorageError(f"cannot encode {draft.name!r}: {error}; export PNG or TIFF instead") from error


LIMITED_RANGE = 1  # FFmpeg's number for levels from 16 to 235; without a number, players stretch the levels


@dataclass(frozen=True)
class _Film:
    """A way to encode. even: what sizes are made a multiple of; 0 for any. channel: the one that is lit of RGB."""

    pixels: str
    range: int
    even: int
    options: dict[str, str]
    channel: int | None = None

    @property
    def codec(self) -> str:
        """FFmpeg's name of the encoder."""
        return "libx264" if self.channel is None else "libx264rgb"

    def frame(self, levels: np.ndarray) -> Any:
        """A picture in the encoder's format."""
        import av

        if self.channel is not None:
            colors = np.zeros((*levels.shape, 3), np.uint8)
            colors[..., self.channel] = levels
            image = av.VideoFrame.from_ndarray(colors, format=self.pixels)
        elif self.range == FULL_RANGE:
            image = av.VideoFrame.from_ndarray(np.ascontiguousarray(levels), format=self.pixels)
        else:
            rows, columns = levels.shape
            planes = np.full((rows * 3 // 2, columns), 128, np.uint8)  # no color
            planes[:rows] = np.rint(LOW + levels * ((HIGH - LOW) / 255.0))
            image = av.VideoFrame.from_ndarray(planes, format=self.pixels)
        image.color_range = self.range
        return image


LOSSLESS = _Film("gray", FULL_RANGE, 0, {"qp": "0", "preset": "ultrafast"})  # a fifth more bytes, 17 times as fast
PLAYERS = _Film("yuv420p", LIMITED_RANGE, 2, {"crf": "4", "preset": "medium", "profile": "high", "bf": "0"})
CHANNELS = {
    name: _Film("rgb24", FULL_RANGE, 2, {"qp": "0", "preset": "ultrafast"}, channel)
    for channel, name in enumerate(("red", "green", "blue"))
}

FORMATS: dict[str, Callable[[_Shown, Path], None]] = {
    "": _png,
    ".tif": _tiff,
    ".tiff": _tiff,
    ".npz": _npz,
    ".mp4": _mp4,
}

"""Folders of images, and videos: those that this library exports or OpenCAL plays, and similar ones."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from vamgpu.errors import BadInput, StorageError
from vamgpu.geometry import Turntable
from vamgpu.jobs.foreign.patterns import ForeignPatterns
from vamgpu.printing.export import Canvas
from vamgpu.printing.frames import Frames
from vamgpu.printing.gray import GrayCurve
from vamgpu.printing.placement import Placement
from vamgpu.quantity import counted
from vamgpu.storage.films import read_film
from vamgpu.storage.images import read_exr, read_image
from vamgpu.storage.memory import afford
from vamgpu.storage.reading import is_file, parse_json, read_text
from vamgpu.storage.turntable import turntable_from

IMAGES = (".png", ".tif", ".tiff", ".bmp", ".exr")
NUMBERS = re.compile(r"(\d+)")
TOP = {"uint8": 255.0, "uint16": 65535.0, "bool": 1.0}
DESCRIPTION = "frames.json"


@dataclass(frozen=True)
class Layout:
    """Orientation of images without a description. None means the middle, all images, or linear gray levels."""

    flip_r: bool = False  # column 0 is the largest r
    flip_z: bool = False  # row 0 is the smallest z, as in videos of VAMToolbox
    reverse: bool = False  # in order of decreasing angle
    axis: float | None = None  # column of the axis, from 0
    level: float | None = None  # row of the part's middle, from 0
    angles: int | None = None  # images per turn
    gray: GrayCurve | None = None


def read_pictures(path: Path, layout: Layout) -> ForeignPatterns:
    """Patterns from a folder of images, or from a video. Raises `StorageError`, `BadInput`."""
    if path.is_dir():
        levels, remark = images_of(path)
    else:
        levels, remark = read_film(path)
    if '"settings"' in remark:
        return _ours(levels, remark, path)
    turn = levels.shape[0] if layout.angles is None else layout.angles
    if not 0 < turn <= levels.shape[0]:
        images = counted(levels.shape[0], "image")
        raise BadInput(f"{str(path)!r} has {images}; expected at least the {turn} of one turn")
    light = _light(levels[:turn], layout.gray)
    light = light[:, ::-1] if not layout.flip_z else light  # now row 0 is the smallest z
    light = light[:, :, ::-1] if layout.flip_r else light
    rows, columns = light.shape[1:]
    middle_r = 0.5 * (columns - 1) if layout.axis is None else layout.axis
    middle_z = 0.5 * (rows - 1) if layout.level is None else layout.level
    if layout.flip_r:
        middle_r = columns - 1 - middle_r
    if not layout.flip_z:
        middle_z = rows - 1 - middle_z
    light = light[:, _around(np.max(light, axis=(0, 2)), middle_z, path), :]
    light = light[:, :, _around(np.max(light, axis=(0, 1)), middle_r, path)]
    if layout.reverse:
        light = np.roll(light[::-1], 1, axis=0)
    full = 1.0 if levels.dtype.name in TOP else None
    tables = {"turntable": {"angles": turn}}
    return ForeignPatterns("pictures", np.ascontiguousarray(light.transpose(0, 2, 1)), None, tables, full=full)


def images_of(folder: Path) -> tuple[np.ndarray, str]:
    """The images of a folder [image, row, column] in numeric order, and the text of its ``frames.json``."""
    names = [each for each in folder.iterdir() if each.suffix.lower() in IMAGES and is_file(each)]
    kinds = {each.suffix.lower() for each in names}
    if len(kinds) != 1:
        said = f"images of the kinds {', '.join(sorted(kinds))}" if kinds else "no images"
        raise BadInput(f"{str(folder)!r} holds {said}; expected a folder of one kind of {', '.join(IMAGES)}")
    read = read_exr if kinds == {".exr"} else read_image
    found: list[np.ndarray] = []
    for file in sorted(names, key=_by_number):
        try:
            found.append(read(file))
        except OSError as error:
            if isinstance(error, StorageError):
                raise
            raise StorageError(f"cannot read the image {str(file)!r}: {error}; export it again") from error
        afford(found[0].nbytes * len(names), f"the {len(names)} images of {str(folder)!r}")
        if found[-1].shape != found[0].shape or found[-1].dtype != found[0].dtype:
            raise BadInput(f"{file.name} is {found[-1].dtype} {found[-1].shape}, but the first image is "
                           f"{found[0].dtype} {found[0].shape}; expected images of one size and kind")  # fmt: skip
    try:
        remark = read_text(folder / DESCRIPTION) if is_file(folder / DESCRIPTION) else ""
    except (OSError, UnicodeDecodeError) as error:
        raise StorageError(f"cannot read {DESCRIPTION} of {str(folder)!r}: {error}; export it again") from error
    return np.stack(found), remark


def _by_number(file: Path) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in NUMBERS.split(file.name)]


def _light(levels: np.ndarray, gray: GrayCurve | None) -> np.ndarray:
    """Light of gray levels, 1 for a full-on pixel; images of floats are not changed."""
    top = TOP.get(levels.dtype.name)
    if top is None:
        if levels.dtype.kind != "f" or not np.isfinite(levels).all():
            raise BadInput(f"the images hold {levels.dtype}; expected gray levels of 1, 8 or 16 bits, or finite light")
        return np.maximum(levels, 0.0).astype(np.float32)
    shares = levels.astype(np.float32) * np.float32(1.0 / top)
    return shares if gray is None else gray(255.0 * shares).astype(np.float32)


def _around(lit: np.ndarray, middle: float, path: Path) -> slice:
    """The smallest range of pixels, symmetric about a middle, that holds all lit pixels. Raises `BadInput`."""
    places = np.flatnonzero(lit)
    if not places.size:
        raise BadInput(f"every image of {str(path)!r} is black; expected some light")
    if 2.0 * middle != round(2.0 * middle) or not 0 <= middle <= lit.size - 1:
        raise BadInput(f"the axis is at pixel {middle:g} of {lit.size}; expected a whole or half pixel: measure again")
    reach, room = max(middle - places[0], places[-1] - middle), min(middle, lit.size - 1 - middle)
    if reach > room:
        raise BadInput(
            f"light reaches from pixel {places[0]} to {places[-1]} of {lit.size}, about an axis at {middle:g} with "
            "too few pixels on one side; expected images with the axis nearer to their middle"
        )
    return slice(round(middle - reach), round(middle + reach) + 1)


def _ours(levels: np.ndarray, remark: str, path: Path) -> ForeignPatterns:
    """Light of this library's exports, which contain their orientation. Raises `StorageError`, `BadInput`."""
    try:
        said = parse_json(remark)
        if "flat_field" in said:
            raise BadInput(f"{str(path)!r} corrects a projector's flat field, but does not contain it; expected frames "
                           "without this correction: prove the job from which it was exported")  # fmt: skip
        settings = Placement(**{**said["settings"], "shift": tuple(said["settings"]["shift"])})
        bits, columns = int(said["bits"]), int(said["columns"])
        angles, rows = int(said["angles"]), int(said["rows"])
        if "canvas" in said:
            placed: dict[str, Any] = said["canvas"]
            lists = {name: tuple(value) for name, value in placed.items() if isinstance(value, list)}
            placed.update(lists)
            levels = Canvas(**placed).undone(levels, angles, rows, columns)
        levels = levels[:, :rows, :columns]  # videos of an even size have some more
        images = levels if bits == 8 else np.packbits(levels > (127 if levels.dtype == np.uint8 else 0), axis=2)
        frames = Frames.from_bytes(np.ascontiguousarray(images), "numpy", bits=bits, columns=columns,
                                   gray=GrayCurve.parse(said["gray"]), scale=float(said["scale"]),
                                   settings=settings)  # fmt: skip
        motion: Turntable | None = None if "turntable" not in said else turntable_from(said["turntable"])
    except BadInput:
        raise
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise StorageError(f"the description of {str(path)!r} is malformed: {error}; export it again") from error
    tables: dict[str, Any] = {"turntable": {"angles": levels.shape[0]}}
    light = frames.irradiance().numpy().astype(np.float32)
    return ForeignPatterns("vamgpu", light, motion, tables, full=frames.scale)

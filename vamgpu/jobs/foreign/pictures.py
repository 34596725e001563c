"""Folders of images, videos and arrays: those of this library, OpenCAL and TVAM-code, and similar ones."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
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
from vamgpu.storage.folder import MANIFEST
from vamgpu.storage.images import read_exr, read_image
from vamgpu.storage.memory import afford
from vamgpu.storage.numpy_files import read_npz
from vamgpu.storage.reading import is_file, parse_json, read_text
from vamgpu.storage.turntable import turntable_from

IMAGES = (".png", ".tif", ".tiff", ".bmp", ".exr")
NUMBERS = re.compile(r"(\d+)")
TOP = {"uint8": 255.0, "uint16": 65535.0, "bool": 1.0}
DESCRIPTION = "frames.json"
ALONG_R = (
    "patterns of 768 × 1024 pixels count as TVAM-code's, whose columns lie along the axis; give those of other "
    "programs as a folder of images"
)
TVAM_CODE = (768, 1024)
"""Shape of TVAM-code's patterns, whose rows are along r; in other images, and if the sizes are exchanged, along z."""


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
    tvam_code: bool = False  # rows are along r if they have 768 pixels, and the brightest pixel is full on


def read_pictures(path: Path, layout: Layout) -> ForeignPatterns:
    """Patterns from a folder of images, a video or an NPZ file. Raises `StorageError`, `BadInput`."""
    notes: tuple[str, ...] = ()
    if path.is_dir():
        levels, remark = images_of(path)
    elif path.suffix.lower() == ".npz":
        levels, remark = _patterns(path), ""
        if levels.shape[1:] == TVAM_CODE and not layout.tvam_code:
            layout, notes = replace(layout, tvam_code=True), (ALONG_R,)
    else:
        levels, remark = read_film(path)
    if layout.tvam_code:
        if levels.shape[1:] not in (TVAM_CODE, TVAM_CODE[::-1]):
            raise BadInput(f"{str(path)!r} has images of {levels.shape[1]} × {levels.shape[2]} pixels; expected 768 × "
                           "1024 or 1024 × 768, as for TVAM-code: leave out --for")  # fmt: skip
        levels = levels.transpose(0, 2, 1) if levels.shape[1:] == TVAM_CODE else levels  # rows along z
    elif '"settings"' in remark:
        return _ours(levels, remark, path)
    turn = levels.shape[0] if layout.angles is None else layout.angles
    if not 0 < turn <= levels.shape[0]:
        images = counted(levels.shape[0], "image")
        raise BadInput(f"--angles is {turn}, but {str(path)!r} has {images}; expected the number of one turn, at least "
                       "1: correct it")  # fmt: skip
    light = _light(levels[:turn], layout.gray)
    light = light[:, ::-1] if not layout.flip_z else light  # now row 0 is the smallest z
    light = light[:, :, ::-1] if layout.flip_r else light
    rows, columns = light.shape[1:]
    middle_r = _middle(layout.axis, "--axis", f"{columns} columns")
    middle_z = _middle(layout.level, "--level", f"{rows} rows")
    if layout.flip_r:
        middle_r = columns - 1 - middle_r
    if not layout.flip_z:
        middle_z = rows - 1 - middle_z
    light = light[:, _around(np.max(light, axis=(0, 2)), middle_z, path, "row"), :]
    light = light[:, :, _around(np.max(light, axis=(0, 1)), middle_r, path, "column")]
    if layout.reverse:
        light = np.roll(light[::-1], 1, axis=0)
    full = 1.0 if levels.dtype.name in TOP and not layout.tvam_code else None
    tables = {"turntable": {"angles": turn}}
    return ForeignPatterns(
        "pictures", np.ascontiguousarray(light.transpose(0, 2, 1)), None, tables, full=full, notes=notes
    )


def _patterns(path: Path) -> np.ndarray:
    """The array ``patterns`` [angle, row, column]. Raises `StorageError`, `BadInput`."""
    held = read_npz(path)
    found = held.get("patterns")
    if found is None or found.ndim != 3 or not found.size:
        got = ", ".join(held) if found is None else f"patterns of shape {found.shape}"
        raise BadInput(f"{str(path)!r} holds {got or 'nothing'}; expected an array patterns [angle, row, column]")
    return found


def images_of(folder: Path) -> tuple[np.ndarray, str]:
    """The images of a folder [image, row, column] in numeric order, and the text of its ``frames.json``."""
    names = [each for each in folder.iterdir() if each.suffix.lower() in IMAGES and is_file(each)]
    kinds = {each.suffix.lower() for each in names}
    if is_file(folder / MANIFEST):
        raise BadInput(f"{str(folder)!r} is a job folder already; expected patterns of another program: prove it with "
                       f"vam prove {folder}")  # fmt: skip
    if len(kinds) != 1:
        lossy = any(each.suffix.lower() in (".jpg", ".jpeg") for each in folder.iterdir())
        said = f"images of the kinds {', '.join(sorted(kinds))}" if kinds else "no images"
        said += " besides JPG, which loses gray levels and is not read" * lossy
        raise BadInput(f"{str(folder)!r} holds {said}; expected a folder of one kind of {', '.join(IMAGES)}")
    names.sort(key=_form)
    _check_numbers(names)
    read = read_exr if kinds == {".exr"} else read_image
    found: list[np.ndarray] = []
    for file in names:
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


def _form(file: Path) -> tuple[str, tuple[int, ...]]:
    """A file's name with # in place of its numbers, and the numbers."""
    return NUMBERS.sub("#", file.name), tuple(map(int, NUMBERS.findall(file.name)))


def _check_numbers(files: Sequence[Path]) -> None:
    """Reject a stray file among numbered ones, and numbers that repeat or have a gap. Raises `BadInput`."""
    ((usual, count),) = Counter(_form(file)[0] for file in files).most_common(1)
    if "#" in usual and count < len(files):
        stray = next(file.name for file in files if _form(file)[0] != usual)
        raise BadInput(f"{stray!r} is named otherwise than the {count} images {usual}; expected only images that "
                       "are numbered in the order of their angles: remove or rename it")  # fmt: skip
    changing = [each for each in zip(*(_form(file)[1] for file in files), strict=False) if len(set(each)) > 1]
    steps = np.diff(changing[0]) if len(changing) == 1 else np.zeros(0, int)
    if steps.size and (steps != max(steps.min(), 1)).any():
        where = int(np.flatnonzero(steps != max(steps.min(), 1))[0])
        raise BadInput(f"between {files[where].name!r} and {files[where + 1].name!r} the numbers go from "
                       f"{changing[0][where]} to {changing[0][where + 1]}; expected equal steps, one for each "
                       "angle: add or rename images")  # fmt: skip


def _light(levels: np.ndarray, gray: GrayCurve | None) -> np.ndarray:
    """Light of gray levels, 1 for a full-on pixel; images of floats are not changed."""
    top = TOP.get(levels.dtype.name)
    if top is None:
        if levels.dtype.kind != "f" or not np.isfinite(levels).all():
            raise BadInput(f"the images hold {levels.dtype}; expected gray levels of 1, 8 or 16 bits, or finite light")
        return np.maximum(levels, 0.0).astype(np.float32)
    shares = levels.astype(np.float32) * np.float32(1.0 / top)
    return shares if gray is None else gray(255.0 * shares).astype(np.float32)


def _middle(given: float | None, option: str, size: str) -> float:
    """The middle of so many columns or rows, unless it is given. Raises `BadInput`."""
    last = int(size.split()[0]) - 1
    if given is not None and not (0 <= given <= last and (2.0 * given).is_integer()):
        raise BadInput(f"{option} is {given:g}, and the images have {size}; expected 0 to {last}, in steps of 0.5: "
                       "measure again")  # fmt: skip
    return 0.5 * last if given is None else given


def _around(lit: np.ndarray, middle: float, path: Path, what: str) -> slice:
    """The smallest range of pixels, symmetric about a middle, that holds all lit pixels. Raises `BadInput`."""
    places = np.flatnonzero(lit)
    if not places.size:
        raise BadInput(f"every image of {str(path)!r} is black; expected some light")
    reach, room = max(middle - places[0], places[-1] - middle), min(middle, lit.size - 1 - middle)
    if reach > room:
        raise BadInput(
            f"light reaches from {what} {places[0]} to {places[-1]} of {lit.size}, about a middle at {middle:g} with "
            f"too few {what}s on one side; expected images with this middle nearer to their own"
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

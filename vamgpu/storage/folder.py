"""Job folders: a Zarr group of arrays with a manifest that records their names, dates and hashes."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from vamgpu.backend.array import DeviceArray
from vamgpu.errors import BadInput, StorageError
from vamgpu.storage.arrays import HEADER, read, read_one, read_parts, write, write_header
from vamgpu.storage.atomic import as_path, check_folder, explained, replacing, settle
from vamgpu.storage.manifest import ArrayRecord, Manifest
from vamgpu.storage.reading import is_file, read_text

VERSION = "0.5"
SPACE = ("x", "y", "z", "row", "column")  # names of an array's axes in space; other axes are counters
FIRST = ("dose", "target", "frames")  # arrays for a viewer that shows one image, the best first


@dataclass(frozen=True)
class Image:
    """An array of a folder that is a picture."""

    name: str
    axes: tuple[str, ...]  # names of its axes
    shape: tuple[int, ...]  # one length for each of them
    spacing: float  # distance of neighbors in space [mm]

    def multiscale(self) -> dict[str, Any]:
        """The image at its one resolution, centered on the axis of rotation, or on that of the light."""
        space = [axis in SPACE for axis in self.axes]
        scale = [self.spacing if inside else 1.0 for inside in space]
        lengths = zip(space, self.shape, strict=True)
        corner = [-0.5 * (n - 1) * self.spacing if inside else 0.0 for inside, n in lengths]
        axes = [{"name": axis, "type": "space", "unit": "millimeter"} if inside else {"name": axis, "type": axis}
                for axis, inside in zip(self.axes, space, strict=True)]  # fmt: skip
        placed = [{"type": "scale", "scale": scale}, {"type": "translation", "translation": corner}]
        return {"name": self.name, "axes": axes,
                "datasets": [{"path": self.name, "coordinateTransformations": placed}]}  # fmt: skip


def describe(folder: Path, images: Iterable[Image]) -> None:
    """Say in the Zarr group of a folder which of its arrays are images, and where their voxels are."""
    rank = {name: place for place, name in enumerate(FIRST)}
    ordered = sorted(images, key=lambda image: rank.get(image.name, len(rank)))
    if ordered:
        said = {"version": VERSION, "multiscales": [image.multiscale() for image in ordered]}
        write_header(folder, "group", {"ome": said})


MANIFEST = "manifest.json"


@dataclass(frozen=True, eq=False)
class Streamed:
    """Values that are computed in parts while they are stored, for arrays larger than memory."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    part: Callable[[int, int], np.ndarray]  # (start, stop) → entries of the first axis, [entry, …]


@dataclass(frozen=True, eq=False)
class Entry:
    """An array to store."""

    # NumPy, on a device, or computed in parts; of any shape [one length for each of ``axes``]
    values: np.ndarray | DeviceArray | Streamed
    axes: tuple[str, ...]  # names of its axes
    unit: str = "1"  # its unit; "1" for a plain number
    spacing: float | None = None  # distance of neighbors in space [mm], for viewers; None if it is not a picture


@dataclass(frozen=True)
class Folder:
    """A job folder that was opened: its manifest, and its arrays on demand."""

    path: Path
    manifest: Manifest

    @classmethod
    def open(cls, path: str | Path) -> Folder:
        """Read the manifest of a job folder."""
        file = Path(path) / MANIFEST
        try:
            text = read_text(file)
        except (FileNotFoundError, NotADirectoryError) as error:
            raise StorageError(f"{str(path)!r} is not a finished job: it has no {MANIFEST}; check the path") from error
        except UnicodeDecodeError as error:
            raise StorageError(f"{str(file)!r} is damaged: {error}; write the job again") from error
        except OSError as error:
            raise explained("read", file, error) from error
        return cls(Path(path), Manifest.from_json(text, file))

    def record(self, name: str) -> ArrayRecord:
        """The manifest's record of an array."""
        if name not in self.manifest.arrays:
            known = ", ".join(self.manifest.arrays) or "none"
            raise StorageError(f"{str(self.path)!r} has no array {name!r}; it has {known}")
        return self.manifest.arrays[name]

    def array(self, name: str) -> np.ndarray:
        """Read a whole array, verified by its hash."""
        record = self.record(name)
        values, found = read(self.path, name, record.shape, record.dtype)
        self._compare(name, found)
        return values

    def parts(self, name: str) -> Iterator[np.ndarray]:
        """Read a whole array in successive parts along the first axis, verified by its hash at the end."""
        record, seal = self.record(name), hashlib.sha256()
        with ThreadPoolExecutor(1) as pool:
            hashed: Future[None] | None = None
            for part in read_parts(self.path, name, record.shape, record.dtype):
                if hashed is not None:
                    hashed.result()
                hashed = pool.submit(seal.update, part.view(np.uint8).data)
                yield part
        self._compare(name, seal.hexdigest())

    def _compare(self, name: str, found: str) -> None:
        expected = self.record(name).sha256
        if found != expected:
            raise StorageError(
                f"array {name!r} of {str(self.path)!r} has SHA-256 {found[:12]}…, its manifest says "
                f"{expected[:12]}…; the job was changed or damaged, write it again"
            )

    def one(self, name: str, index: int) -> np.ndarray:
        """Read one entry along the first axis, such as one frame, verified by the checksum of its chunk."""
        record = self.record(name)
        if not 0 <= index < record.shape[0]:
            raise BadInput(f"index {index} of {name!r}; expected 0 to {record.shape[0] - 1}")
        return read_one(self.path, name, record.shape, record.dtype, index)

    def verify(self) -> None:
        """Read every array and compare it with its hash."""
        for name in self.manifest.arrays:
            for _ in self.parts(name):
                pass


def check_place(path: str | Path, *, overwrite: bool = False) -> None:
    """Before a long computation, reject a path at which no job folder can be written."""
    place = as_path(path)
    check_folder(place)
    if not os.path.lexists(place):
        return
    if not overwrite:
        raise StorageError(f"{str(path)!r} exists; choose another path, or allow overwriting it (--overwrite)")
    if not is_file(place / MANIFEST):
        raise StorageError(f"{str(path)!r} exists and is not a job folder; choose another path")


def write_folder(
    path: str | Path,
    arrays: Mapping[str, Entry],
    *,
    inputs: Mapping[str, Any],
    details: Mapping[str, Any],
    device: str,
    overwrite: bool = False,
) -> Folder:
    """Write a job folder, completely or not at all."""
    # Arrays are fetched and written one after another and in parts, one chunk per entry along the first axis.
    place = as_path(path)
    if overwrite and os.path.lexists(place) and not is_file(place / MANIFEST):
        raise StorageError(f"{str(path)!r} exists and is not a job folder; choose another path")
    Manifest(dict(inputs), dict(details), device, {}).to_json()  # reject bad inputs before the long computation
    with replacing(place, overwrite=overwrite) as draft:
        draft.mkdir()
        records = {name: _store(draft, name, entry) for name, entry in arrays.items()}
        describe(draft, (Image(name, entry.axes, records[name].shape, entry.spacing)
                         for name, entry in arrays.items() if entry.spacing is not None))  # fmt: skip
        manifest = Manifest(dict(inputs), dict(details), device, records)
        (draft / MANIFEST).write_text(manifest.to_json(), encoding="utf-8")
        settle(draft / MANIFEST, *draft.rglob(HEADER), *(one for one in draft.rglob("*") if one.is_dir()), draft)
    return Folder.open(place)


def _store(draft: Path, name: str, entry: Entry) -> ArrayRecord:
    values, shape, dtype = entry.values, tuple(entry.values.shape), np.dtype(entry.values.dtype)
    if not (name.isidentifier() and prod(shape) and shape and len(shape) == len(entry.axes) and dtype.kind in "biuf"):
        raise BadInput(
            f"array {name!r} is {dtype} {shape} with axes {entry.axes}; "
            "expected a plain name, some numbers, and one name per axis"
        )
    source = (
        Streamed(shape, dtype, lambda first, last: values[first:last]) if isinstance(values, np.ndarray) else values
    )
    seal = write(draft, name, source, entry.axes)
    return ArrayRecord(shape, dtype.name, tuple(entry.axes), entry.unit, seal)


def digest(values: np.ndarray) -> str:
    """Hash an array."""
    return hashlib.sha256(np.ascontiguousarray(values).view(np.uint8).data).hexdigest()

"""Slices written to files: a stack appears under its name when it is complete, and never replaces the originals."""

from __future__ import annotations

import json
import os
import re
import zipfile
import zlib
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from vamgpu.backend.cores import threads
from vamgpu.curethrough.images import encode
from vamgpu.curethrough.stack import ARCHIVES, PACKED, PackedStack, ZipStack
from vamgpu.errors import StorageError
from vamgpu.storage.atomic import replacing
from vamgpu.storage.manifest import plain
from vamgpu.storage.reading import open_file, parse_json, read_text
from vamgpu.storage.zips import open_zip, unpacked

RECORD = "curethrough.json"  # file in a folder or a zip of slices that records their settings
WAITING = 64  # greatest number of slices that wait to be written; more would fill the memory if the disk is slow


class Writer(AbstractContextManager["Writer"]):
    """Encodes slices on all processors and puts them in order; ``names`` begins with slice 0."""

    def __init__(
        self, names: tuple[str, ...], put: Callable[[str, bytes], object],
        code: Callable[[np.ndarray, str], bytes] = encode,
    ) -> None:  # fmt: skip
        self.names: tuple[str, ...] = names
        self._put, self._code = put, code
        self._pool = ThreadPoolExecutor(threads(), "slices")
        self._coding: deque[tuple[str, Future[bytes]]] = deque()
        self.written: int = 0

    def write(self, start: int, levels: np.ndarray) -> None:
        """Write slices from number ``start`` on, uint8 [slice, y, x]; the caller must not change them afterwards."""
        for k, picture in enumerate(levels):
            name = self.names[start + k]
            self._coding.append((name, self._pool.submit(self._code, picture, PurePosixPath(name).suffix)))
            while len(self._coding) > WAITING:
                self._one()

    def _one(self) -> None:
        name, coded = self._coding.popleft()
        data = coded.result()
        self.written += len(data)
        self._put(name, data)

    def __exit__(self, failed: type[BaseException] | None, *_: object) -> None:
        try:
            while self._coding and failed is None:
                self._one()
        finally:
            self._pool.shutdown(cancel_futures=True)


@contextmanager
def writing(
    path: str | Path, names: tuple[str, ...], *, source: object = None, overwrite: bool = False,
    record: Mapping[str, Any] | None = None,
) -> Iterator[Writer]:  # fmt: skip
    """Open a writer to a folder or a zip, which gets its name when it is complete. Raises `StorageError`."""
    place = Path(path)
    check_place(place, source, overwrite=overwrite)
    with replacing(place, overwrite=overwrite) as draft:
        if place.suffix.lower() in PACKED and isinstance(source, PackedStack):
            layers = dict.fromkeys(names, b"")  # they arrive in any order
            with draft.open("wb") as file:
                with Writer(names, layers.__setitem__, source.file.encode) as writer:
                    yield writer
                file.writelines(source.file.packed(list(layers.values())))
            return
        if place.suffix.lower() not in ARCHIVES:
            for folder in {draft / PurePosixPath(name).parent for name in names}:
                folder.mkdir(parents=True, exist_ok=True)
            with Writer(names, lambda name, data: (draft / name).write_bytes(data)) as writer:
                yield writer
            (draft / RECORD).write_text(_text(record), encoding="utf-8")
            return
        with zipfile.ZipFile(draft, "w", zipfile.ZIP_STORED) as archive:
            with Writer(names, archive.writestr) as writer:  # pictures are already compressed
                yield writer
            if place.suffix.lower() == ".zip":
                archive.writestr(RECORD, _text(record))
            elif isinstance(source, ZipStack):
                _take_over(archive, source, len(names))
            place_of = {name: k for k, name in enumerate(names)}
            archive.filelist.sort(key=lambda info: place_of.get(info.filename, -1))  # readers may depend on this order


def made_with(path: str | Path, record: Mapping[str, Any]) -> bool:
    """Whether slices were made with this record; those of an SL1 have none.

    Args:
        path: Where `writing` put slices, a folder or a zip.
        record: Its record, or part of it.

    Returns:
        Whether there are slices with the same record.
    """
    place = Path(path)
    try:
        if place.suffix.lower() in ARCHIVES:
            with open_file(place) as file, open_zip(file) as archive:
                found = parse_json(unpacked(archive, RECORD))
        else:
            found = parse_json(read_text(place / RECORD))
        return isinstance(found, dict) and all(found.get(key) == value for key, value in plain(record).items())
    except (OSError, ValueError, KeyError, zipfile.BadZipFile, zlib.error):
        return False


def check_place(path: str | Path, source: object = None, *, overwrite: bool = False) -> None:
    """Check that slices replace neither the originals nor other files.

    Args:
        path: A folder or a file for slices.
        source: The stack that they are made from.
        overwrite: Allow slices that were written before to be replaced.

    Raises:
        StorageError: Slices must not be written there.
    """
    place = Path(path)
    origin = getattr(source, "place", None)
    if origin is not None:
        there, new = Path(origin).resolve(), place.resolve()
        if new == there or there in new.parents or new in there.parents:
            raise StorageError(
                f"{str(path)!r} would overwrite the originals in {str(origin)!r}; choose a path beside them"
            )
    held = source.others if isinstance(source, ZipStack) else ()
    if place.suffix.lower() in (".sl1", ".sl1s") and not any(info.filename == "config.ini" for info in held):
        raise StorageError(f"{str(path)!r} would lack the printer settings of an SL1 file; write a .zip or a folder")
    ending, had = place.suffix.lower(), getattr(origin, "suffix", "").lower()
    if ending in PACKED and (ending != had or not isinstance(source, PackedStack)):
        raise StorageError(
            f"{str(path)!r} would lack the printer settings of a {ending} file; write a .zip or a folder"
        )
    if not os.path.lexists(place):
        return
    if not overwrite:
        raise StorageError(f"{str(path)!r} exists; choose another path, or allow overwriting it")
    folder = place.suffix.lower() not in (*ARCHIVES, *PACKED)
    if folder != place.is_dir() or (folder and not (place / RECORD).is_file()):
        raise StorageError(f"{str(path)!r} exists and holds no corrected slices; choose another path")


def _take_over(archive: zipfile.ZipFile, source: ZipStack, slices: int) -> None:
    """The files of an SL1 except its layers; the number of layers is updated."""
    for info in source.others:
        data = source.entry(info.filename)
        if info.filename == "config.ini":
            layers = f"numFast = {slices}".encode()
            data = re.sub(rb"^numFast\s*=\s*\d+", layers, data, flags=re.MULTILINE)
        archive.writestr(info.filename, data, zipfile.ZIP_DEFLATED)


def _text(record: Mapping[str, Any] | None) -> str:
    return json.dumps(plain(dict(record or {}), "record"), indent=2, ensure_ascii=False) + "\n"

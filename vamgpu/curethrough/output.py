"""Slices written to files: a stack appears under its name when it is complete, and never replaces the originals."""

from __future__ import annotations

import json
import os
import re
import zipfile
import zlib
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import Any, BinaryIO

import numpy as np

from vamgpu.backend.cores import threads
from vamgpu.curethrough.goo import END, encode_goo
from vamgpu.curethrough.images import encode
from vamgpu.curethrough.stack import ARCHIVES, GooStack, ZipStack
from vamgpu.errors import StorageError
from vamgpu.storage.atomic import replacing
from vamgpu.storage.manifest import plain
from vamgpu.storage.reading import open_file, parse_json, read_text
from vamgpu.storage.zips import open_zip, unpacked

RECORD = "curethrough.json"
"""File in a folder or a zip of slices that records their settings."""
WAITING = 64
"""Greatest number of slices that wait to be written; more would fill the memory if the disk is slow."""


class Writer(ABC):
    """Encodes slices on all processors and writes them in order; ``names`` begins with slice 0."""

    code: Callable[[np.ndarray, str], bytes] = staticmethod(encode)

    def __init__(self, names: tuple[str, ...]) -> None:
        self.names = names
        self._pool = ThreadPoolExecutor(threads(), "slices")
        self._coding: deque[tuple[str, Future[bytes]]] = deque()
        self.written: int = 0

    def write(self, start: int, levels: np.ndarray) -> None:
        """Write slices from number ``start`` on, uint8 [slice, y, x]; the caller must not change them afterwards."""
        for k, picture in enumerate(levels):
            name = self.names[start + k]
            self._coding.append((name, self._pool.submit(self.code, picture, PurePosixPath(name).suffix)))
            while len(self._coding) > WAITING:
                self._one()

    def finish(self) -> None:
        """Write the slices that still wait."""
        while self._coding:
            self._one()
        self._pool.shutdown()

    def drop(self) -> None:
        """Drop the slices that still wait."""
        self._pool.shutdown(cancel_futures=True)

    def _one(self) -> None:
        name, coded = self._coding.popleft()
        data = coded.result()
        self.written += len(data)
        self.put(name, data)

    @abstractmethod
    def put(self, name: str, data: bytes) -> None:
        """Write a file."""


class _Folder(Writer):
    def __init__(self, draft: Path, names: tuple[str, ...]) -> None:
        super().__init__(names)
        self._draft = draft
        for folder in {draft / PurePosixPath(name).parent for name in names}:
            folder.mkdir(parents=True, exist_ok=True)

    def put(self, name: str, data: bytes) -> None:
        (self._draft / name).write_bytes(data)


class _Zip(Writer):
    def __init__(self, archive: zipfile.ZipFile, names: tuple[str, ...]) -> None:
        super().__init__(names)
        self._archive = archive

    def put(self, name: str, data: bytes) -> None:
        self._archive.writestr(name, data)  # pictures are already compressed


class _Goo(Writer):
    """Layers with the settings of the file they were read from."""

    code = staticmethod(encode_goo)

    def __init__(self, file: BinaryIO, source: GooStack, names: tuple[str, ...]) -> None:
        super().__init__(names)
        self._file, self._goo, self._count = file, source.goo, 0
        file.write(source.goo.head(len(names)))

    def put(self, name: str, data: bytes) -> None:
        self._file.write(self._goo.layer(self._count, data))
        self._count += 1


@contextmanager
def writing(
    path: str | Path, names: tuple[str, ...], *, source: object = None, overwrite: bool = False,
    record: Mapping[str, Any] | None = None,
) -> Iterator[Writer]:  # fmt: skip
    """Open a writer to a folder or a zip, which gets its name when it is complete. Raises `StorageError`."""
    place = Path(path)
    check_place(place, source, overwrite=overwrite)
    with replacing(place, overwrite=overwrite) as draft:
        if place.suffix.lower() == ".goo" and isinstance(source, GooStack):
            with draft.open("wb") as file:
                with _finished(_Goo(file, source, names)) as writer:
                    yield writer
                file.write(END)
            return
        if place.suffix.lower() not in ARCHIVES:
            draft.mkdir()
            with _finished(_Folder(draft, names)) as writer:
                yield writer
            (draft / RECORD).write_text(_text(record), encoding="utf-8")
            return
        with zipfile.ZipFile(draft, "w", zipfile.ZIP_STORED) as archive:
            with _finished(_Zip(archive, names)) as writer:
                yield writer
            if place.suffix.lower() == ".zip":
                archive.writestr(RECORD, _text(record))
            elif isinstance(source, ZipStack):
                _take_over(archive, source, len(names))
            place_of = {name: k for k, name in enumerate(names)}
            archive.filelist.sort(key=lambda info: place_of.get(info.filename, -1))  # readers may depend on this order


@contextmanager
def _finished(writer: Writer) -> Iterator[Writer]:
    try:
        yield writer
        writer.finish()
    finally:
        writer.drop()


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
    """Raise `StorageError` if slices must not be written: over or among the originals, or over other files."""
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
    if place.suffix.lower() == ".goo" and not isinstance(source, GooStack):
        raise StorageError(f"{str(path)!r} would lack the printer settings of a .goo file; write a .zip or a folder")
    if not os.path.lexists(place):
        return
    if not overwrite:
        raise StorageError(f"{str(path)!r} exists; choose another path, or allow overwriting it")
    folder = place.suffix.lower() not in (*ARCHIVES, ".goo")
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

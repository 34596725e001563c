"""Stacks of slices in files, read lazily: uint8 [slice, y, x], slice 0 at the platform, row 0 of a picture first."""

from __future__ import annotations

import os
import re
import stat
import zipfile
from abc import abstractmethod
from collections import Counter
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager
from pathlib import Path, PurePosixPath
from typing import Any
from zipfile import ZipInfo

import numpy as np

from vamgpu.backend.cores import threads
from vamgpu.curethrough.buffers import SliceBuffers
from vamgpu.curethrough.ctb import Ctb
from vamgpu.curethrough.goo import Goo
from vamgpu.curethrough.images import HEAD, MOST_PIXELS, Header, decode, header
from vamgpu.curethrough.names import is_slice, ordered
from vamgpu.errors import SliceError
from vamgpu.storage.atomic import explaining
from vamgpu.storage.memory import afford
from vamgpu.storage.reading import open_file, read_bytes
from vamgpu.storage.zips import open_zip, unpacked

ARCHIVES = (".zip", ".sl1", ".sl1s")
PACKED: dict[str, Any] = {".goo": Goo, ".ctb": Ctb, ".cbddlp": Ctb, ".photon": Ctb}
"""Endings of files that hold layers and settings of a printer in a format of their own."""
AHEAD = 32  # number of slices that are decoded ahead while others are processed
MOST_BYTES = 1 << 28  # upper limit of the size of a slice's file
MOST_PACKED = 1_000_000_000
PREVIEW = re.compile(r"(^|/)((preview|thumb)|3d\.png$)", re.IGNORECASE)  # pictures that slicers put beside the slices
HEIGHTS = {"config.ini": r"^layerHeight\s*=\s*([0-9.eE+-]+)\s*$", "run.gcode": r"^;\s*layerHeight\s*:\s*([0-9.eE+-]+)"}
"""Files of a zip that state the layer height, and how."""
MOST_NAME = 1000  # greatest number of characters of a name in a zip
BLOCKS_HELD = 6  # blocks of slices in memory at a time: two being read, two being written to the disk, and the device's
PIXEL_HELD = 40  # bytes per pixel that the state of a print needs in addition


class FileStack(AbstractContextManager["FileStack"]):
    """Slices in files, decoded ahead on all processors. Use it as a context manager, which closes it."""

    place: Path
    names: tuple[str, ...]  # of the slices, from the platform on

    def __init__(self, place: Path, names: tuple[str, ...]) -> None:
        self.place, self.names = place, names
        plane = self._plane()
        claim = (min(len(names), AHEAD) * BLOCKS_HELD + PIXEL_HELD) * plane[0] * plane[1]
        afford(claim, f"{str(place)!r}, {len(names)} slices of {plane[1]} × {plane[0]} pixels,", SliceError)
        self.shape: tuple[int, int, int] = (len(names), *plane)
        self._pool = ThreadPoolExecutor(threads(), "slices")
        self._buffers = SliceBuffers()
        self._begun: dict[tuple[int, int], tuple[np.ndarray, list[Future[None]]]] = {}

    @abstractmethod
    def _bytes(self, name: str, most: int | None = None) -> bytes:
        """A file, or its first ``most`` bytes; raises `SliceError`."""

    def __len__(self) -> int:
        return len(self.names)

    def __getitem__(self, key: slice, /) -> np.ndarray:
        """Slices, uint8 [slice, y, x]. Raises `SliceError` for an unreadable file or one unlike the others."""
        start, stop, step = key.indices(len(self.names))
        if step != 1:
            raise SliceError(f"slices come in steps of 1; got {step}")
        stop = max(start, stop)
        out, decoding = self._begun.pop((start, stop), None) or self._begin(start, stop)
        for waiting in self._begun.values():  # an order other than before: slices decoded ahead are useless
            _drop(waiting[1])
        self._begun.clear()
        before = max(0, start - AHEAD)
        if before < start and stop - start > 1:  # single slices are read at several places
            self._begun[before, start] = self._begin(before, start)
        try:
            for one in decoding:
                one.result()
        except BaseException:
            _drop(decoding)
            raise
        return out

    def _begin(self, start: int, stop: int) -> tuple[np.ndarray, list[Future[None]]]:
        out = self._buffers.take((stop - start, *self.shape[1:]))
        return out, [self._pool.submit(self._decode, self.names[start + k], out[k]) for k in range(stop - start)]

    def _decode(self, name: str, out: np.ndarray) -> None:
        decode(self._bytes(name), self._label(name), out)

    def _label(self, name: str) -> str:
        return repr(str(self.place / name))

    def _plane(self) -> tuple[int, int]:
        """Pixels of all slices from the headers of their PNGs, or of the first TIFF. Raises `SliceError`."""
        first: Header | None = None
        for name in self.names:
            png = name.lower().endswith(".png")
            if first is not None and not png:
                continue
            found = header(self._bytes(name, HEAD if png else None), self._label(name))
            if first is None:
                first = found
            if found != first:
                kind, other = (f"{one.kind} of {one.shape[1]} × {one.shape[0]} pixels" for one in (found, first))
                raise SliceError(f"{self._label(name)} is {kind}, but {self.names[0]!r} is {other}; expected all "
                                 "slices to be the same: export them again")  # fmt: skip
        assert first is not None
        return first.shape

    def close(self) -> None:
        """Stop reading."""
        for _, decoding in self._begun.values():
            _drop(decoding)
        self._begun.clear()
        self._pool.shutdown(cancel_futures=True)

    def __exit__(self, *_: object) -> None:
        self.close()


class FolderStack(FileStack):
    """The pictures of a folder. Raises `SliceError`."""

    def __init__(self, path: str | Path) -> None:
        place = Path(path)
        try:
            names = [entry.name for entry in os.scandir(place) if is_slice(entry.name) and entry.is_file()]
        except OSError as error:
            raise SliceError(f"cannot read the folder {str(path)!r}: {error.strerror}; check the path") from error
        super().__init__(place, ordered(names, repr(str(path))))

    def _bytes(self, name: str, most: int | None = None) -> bytes:
        with explaining("read", self.place / name):
            if most is None:
                return read_bytes(self.place / name, MOST_BYTES)
            with open_file(self.place / name) as file:
                return file.read(most)


class ZipStack(FileStack):
    """The pictures of a zip, in an SL1 those beside its ``config.ini``. Raises `SliceError`."""

    def __init__(self, path: str | Path) -> None:
        place = Path(path)
        try:
            self._file = open_file(place)
        except OSError as error:
            raise SliceError(f"cannot read the zip {str(path)!r}: {error.strerror}; check the path") from error
        try:
            self._zip = open_zip(self._file)
        except (OSError, zipfile.BadZipFile, ValueError) as error:
            self._file.close()
            raise SliceError(
                f"cannot read the zip {str(path)!r}: {error}; it is cut off or no zip: copy or export it again"
            ) from error
        try:
            self.others: tuple[ZipInfo, ...] = tuple(info for info in self._zip.infolist() if not info.is_dir())
            for info in self.others:
                _check_entry(info, str(path))
            names = _pictures(self.others, str(path))
            self.others = tuple(info for info in self.others if info.filename not in set(names))
            super().__init__(place, ordered(names, repr(str(path))))
        except BaseException:
            self._zip.close()
            self._file.close()
            raise

    def _bytes(self, name: str, most: int | None = None) -> bytes:
        try:
            return unpacked(self._zip, name, most)
        except Exception as error:  # noqa: BLE001 - zipfile and its codecs raise whatever they stumble over
            raise SliceError(
                f"cannot read {self._label(name)}: {error}; the zip is damaged: export it again"
            ) from error

    def entry(self, name: str) -> bytes:
        """Another file of the zip; raises `SliceError`."""
        return self._bytes(name)

    def close(self) -> None:
        """Stop reading and close the zip."""
        super().close()
        self._zip.close()
        self._file.close()


class PackedStack(FileStack):
    """The layers of a .goo or .ctb file. Raises `SliceError`."""

    file: Goo | Ctb

    def __init__(self, path: str | Path) -> None:
        place = Path(path)
        try:
            self.file = PACKED[place.suffix.lower()](read_bytes(place, MOST_PACKED), str(path))
        except OSError as error:
            raise SliceError(f"cannot read {str(path)!r}: {error.strerror or error}; check the path") from error
        super().__init__(place, tuple(f"layer{number:05d}.png" for number in range(self.file.count)))

    def _bytes(self, name: str, most: int | None = None) -> bytes:
        raise SliceError(f"{self._label(name)} is not a separate picture; read the stack")

    def _decode(self, name: str, out: np.ndarray) -> None:
        self.file.decode(int(name[5:-4]), out)

    def _plane(self) -> tuple[int, int]:
        if self.file.shape[0] * self.file.shape[1] > MOST_PIXELS:
            raise SliceError(f"{str(self.place)!r} has layers of {self.file.shape} pixels; expected {MOST_PIXELS:,} in "
                             "all at most: check the file")  # fmt: skip
        return self.file.shape


def open_stack(path: str | Path) -> FileStack:
    """Open the slices of a folder, a zip or an SL1 file.

    Args:
        path: The folder or file.

    Returns:
        The slices, read one at a time.

    Raises:
        SliceError: The path does not exist, or is not of these kinds.
    """
    place = Path(path)
    if os.path.isdir(place):
        return FolderStack(place)
    if not os.path.lexists(place):
        raise SliceError(f"there is nothing at {str(path)!r}; expected a folder of slices or a zip: check the path")
    if place.suffix.lower() in PACKED:
        return PackedStack(place)
    if place.suffix.lower() in ARCHIVES or _is_zip(place):
        return ZipStack(place)
    raise SliceError(f"{str(path)!r} is neither a folder nor a file ending in {', '.join(ARCHIVES)}, .goo or .ctb; "
                     "expected slices: export pictures from the slicer, or check the path")  # fmt: skip


def _is_zip(place: Path) -> bool:
    try:
        with open_file(place) as file:
            return zipfile.is_zipfile(file)
    except OSError:
        return False


def layer_height(stack: object) -> float | None:
    """Read the layer height of an SL1, a .goo or .ctb file, or a zip of Chitubox.

    Args:
        stack: The slices.

    Returns:
        Height of a layer [mm]; None if the file does not state it.
    """
    if isinstance(stack, PackedStack):
        return stack.file.height
    beside = {info.filename for info in stack.others} if isinstance(stack, ZipStack) else set()
    name = next((name for name in HEIGHTS if name in beside), None)
    if name is None or not isinstance(stack, ZipStack):
        return None
    found = re.search(HEIGHTS[name], stack.entry(name).decode("utf-8", "replace"), re.MULTILINE)
    try:
        return float(found[1]) if found else None
    except ValueError:
        return None


def _check_entry(info: zipfile.ZipInfo, place: str) -> None:
    """Reject entries that are dangerous to unpack, and those that cannot be read."""
    name = info.orig_filename.replace("\\", "/")
    path = PurePosixPath(name)
    why = ""
    if path.is_absolute() or ".." in path.parts or re.match(r"[A-Za-z]:", name) or "\0" in name:
        why = "would be unpacked outside its folder"
    elif stat.S_ISLNK(info.external_attr >> 16):
        why = "is a link"
    elif len(name) > MOST_NAME:
        why, name = f"has a name of {len(name)} characters", name[:MOST_NAME]
    elif info.file_size > MOST_BYTES:
        why = f"takes {info.file_size / 1e6:.0f} MB unpacked"
    if why:
        raise SliceError(f"{place!r}: entry {name!r} {why}; nothing was read: pack the slices again")


def _pictures(entries: tuple[zipfile.ZipInfo, ...], place: str) -> list[str]:
    """Names of the slices: all pictures of one folder."""
    every = [info.filename for info in entries]
    twice = next((name for name, count in Counter(every).items() if count > 1), None)
    if twice is not None:
        raise SliceError(f"{place!r} holds {twice!r} more than once; pack the slices again")
    names = [name for name in every if is_slice(name) and not PREVIEW.search(name)]
    if "config.ini" in every:
        return [name for name in names if "/" not in name]
    folders = sorted({str(PurePosixPath(name).parent) for name in names})
    if len(folders) > 1:
        raise SliceError(
            f"{place!r} holds pictures in {len(folders)} folders ({', '.join(folders[:3])}…); expected one"
        )
    return names


def _drop(decoding: list[Future[None]]) -> None:
    for one in decoding:
        one.cancel()

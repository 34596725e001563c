"""Arrays of job folders, mapped from unlinked files: only the parts that are used occupy memory."""

from __future__ import annotations

import io
import json
import tempfile
from collections import OrderedDict
from pathlib import Path
from threading import Lock
from typing import Any, NamedTuple

import numpy as np

from vamgpu.errors import BadInput
from vamgpu.storage.folder import MANIFEST, Folder
from vamgpu.studio.workspace import Stamp, stamp

KEPT = 6  # mapped arrays at a time


class Volumes:
    """The arrays that were read last."""

    def __init__(self) -> None:
        self._known: OrderedDict[tuple[Path, str, Stamp], _Mapped] = OrderedDict()
        self._lock = Lock()

    def of(self, folder: Folder, name: str) -> np.ndarray:
        """An array of a job folder, verified by its hash when it is mapped. Raises `StorageError`."""
        key = folder.path, name, stamp(folder.path / MANIFEST)
        with self._lock:
            entry = self._known.setdefault(key, _Mapped())
            self._known.move_to_end(key)
            while len(self._known) > KEPT:
                self._known.popitem(last=False)
        with entry.lock:  # other arrays are read meanwhile
            if entry.array is None:
                entry.array = _mapped(folder, name)
            return entry.array


class _Mapped:
    """An array that one thread maps while others wait for it."""

    def __init__(self) -> None:
        self.lock = Lock()
        self.array: np.ndarray | None = None


def _mapped(folder: Folder, name: str) -> np.ndarray:
    record = folder.record(name)
    with tempfile.TemporaryFile() as file:
        for part in folder.parts(name):  # written, since a map beyond a full disk would end the server
            file.write(np.ascontiguousarray(part, record.dtype).data)
        file.flush()
        return np.memmap(file, record.dtype, "r", shape=record.shape)


def png(levels: np.ndarray) -> bytes:
    """An image, uint8 [row, column], as a file."""
    from PIL import Image

    held = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(levels)).save(held, "png")
    return held.getvalue()


class Arrays(NamedTuple):
    """Arrays that are sent one after another, and numbers that describe them."""

    arrays: dict[str, np.ndarray]
    meta: dict[str, Any]

    def body(self) -> tuple[bytes, dict[str, str]]:
        """The bytes, each array padded to a multiple of four, and the headers."""
        pieces, said = list[bytes](), list[dict[str, Any]]()
        for name, array in self.arrays.items():
            if array.dtype.kind not in "uf" or array.dtype.itemsize > 4:
                raise BadInput(f"the array {name} is {array.dtype}; expected float16, float32 or unsigned integers")
            data = np.ascontiguousarray(array, array.dtype.newbyteorder("<")).tobytes()
            pieces += [data, b"\0" * (-len(data) % 4)]
            said.append({"name": name, "dtype": array.dtype.name, "shape": list(array.shape)})
        return b"".join(pieces), {"x-arrays": json.dumps(said), "x-meta": json.dumps(self.meta)}

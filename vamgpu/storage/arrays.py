"""Arrays of a job folder in Zarr v3: one chunk per entry of the first axis, many chunks per file."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from vamgpu.backend.cores import ahead, threads
from vamgpu.errors import StorageError
from vamgpu.storage.memory import afford
from vamgpu.storage.reading import is_file, parse_json, read_text
from vamgpu.storage.shards import LEVEL, decode, write_files

SHARD_BYTES = 64 * 2**20
SHARD_CHUNKS = 512
"""Size limits of one file: few files for a job of many thousand frames, but small enough to copy easily."""
PIECE = 1 << 23
"""Bytes that a thread unpacks at a time: they are then still in the cache when they are hashed, and the system reuses
the memory for the next part."""
MOST_SHARD = 1 << 20  # number of entries of a file above which its index would become too large


def shard_length(shape: tuple[int, ...], itemsize: int) -> int:
    """Number of entries of the first axis in a file."""
    one = max(1, int(np.prod(shape[1:], dtype=np.int64)) * itemsize)
    return max(1, min(shape[0], SHARD_CHUNKS, SHARD_BYTES // one))


HEADER = "zarr.json"
"""Zarr's file that describes a group or an array."""
LITTLE: dict[str, Any] = {"name": "bytes", "configuration": {"endian": "little"}}


def write_header(folder: Path, kind: str, attributes: dict[str, Any], **said: Any) -> None:
    """Write the header of a group or an array as Zarr writes it: importing Zarr takes longer than storing a job."""
    said |= {"attributes": attributes, "zarr_format": 3, "node_type": kind}
    (folder / HEADER).write_text(json.dumps(said, indent=2), encoding="utf-8")


def create(
    folder: Path, name: str, shape: tuple[int, ...], dtype: np.dtype, shards: tuple[int, ...], axes: tuple[str, ...]
) -> None:
    """Create an empty array in a Zarr group, one chunk per entry of the first axis."""
    codecs = [LITTLE if dtype.itemsize > 1 else {"name": "bytes"},
              {"name": "zstd", "configuration": {"level": LEVEL, "checksum": True}}]  # fmt: skip
    sharding = {"chunk_shape": [1, *shape[1:]], "codecs": codecs, "index_codecs": [LITTLE, {"name": "crc32c"}],
                "index_location": "end"}  # fmt: skip
    if not (folder / HEADER).exists():
        write_header(folder, "group", {})
    (folder / name).mkdir()
    write_header(
        folder / name, "array", {}, shape=shape, data_type=dtype.name, fill_value=dtype.type(0).item(),
        chunk_grid={"name": "regular", "configuration": {"chunk_shape": shards}},
        chunk_key_encoding={"name": "default", "configuration": {"separator": "/"}},
        codecs=[{"name": "sharding_indexed", "configuration": sharding}], dimension_names=axes, storage_transformers=[],
    )  # fmt: skip


class Entries(Protocol):
    """Values to store, which are fetched in parts of the first axis."""

    @property
    def shape(self) -> tuple[int, ...]: ...

    @property
    def dtype(self) -> np.dtype[Any]: ...

    def part(self, first: int, last: int, /) -> np.ndarray: ...


def write(folder: Path, name: str, values: Entries, axes: tuple[str, ...]) -> str:
    """Add an array to the Zarr group at ``folder`` and write it to the disk; returns the SHA-256 of its bytes."""
    shape, dtype = values.shape, values.dtype.newbyteorder("<")
    shard, seal = shard_length(shape, dtype.itemsize), hashlib.sha256()
    create(folder, name, shape, values.dtype, (shard, *shape[1:]), axes)

    def part(first: int, last: int) -> np.ndarray:
        return np.ascontiguousarray(values.part(first, last), dtype)

    layout = Layout(folder / name, shape, dtype, shard)
    write_files(layout.file, shape[0], shard, part, lambda some: seal.update(some.view(np.uint8).data))
    return seal.hexdigest()


def read(folder: Path, name: str, shape: tuple[int, ...], dtype: str) -> tuple[np.ndarray, str]:
    """A whole array and its SHA-256. Raises `StorageError` if it is missing, damaged, or different from its record."""
    with undamaged(f"array {name!r}", folder, "job"):
        layout, seal = _layout(folder, name, shape, dtype), hashlib.sha256()
        values = layout.entries(range(shape[0]), whole=True, seen=lambda part: seal.update(part.view(np.uint8).data))
        return values, seal.hexdigest()


def read_one(folder: Path, name: str, shape: tuple[int, ...], dtype: str, index: int) -> np.ndarray:
    """One entry of the first axis. Raises `StorageError` as `read` does."""
    with undamaged(f"array {name!r}", folder, "job"):
        return _layout(folder, name, shape, dtype).entries(range(index, index + 1), whole=True)[0]


def read_parts(folder: Path, name: str, shape: tuple[int, ...], dtype: str) -> Iterator[np.ndarray]:
    """A whole array, some entries at a time. Raises `StorageError` as `read` does."""
    with undamaged(f"array {name!r}", folder, "job"):
        parts = _layout(folder, name, shape, dtype).parts()
    while True:
        with undamaged(f"array {name!r}", folder, "job"):
            part = next(parts, None)
        if part is None:
            return
        yield part


@contextmanager
def undamaged(what: str, folder: Path, kind: str) -> Iterator[None]:
    """Error text for a part of a folder that cannot be read. Raises `StorageError`."""
    try:
        yield
    except StorageError:
        raise
    except Exception as error:  # noqa: BLE001 - damaged files raise whatever the codec that met them raises
        raise StorageError(
            f"cannot read {what} of {str(folder)!r}: {type(error).__name__}: {error}; the {kind} is damaged, write it "
            "again"
        ) from error


def _layout(folder: Path, name: str, shape: tuple[int, ...], dtype: str) -> Layout:
    layout = Layout.of(folder / name)
    if (layout.shape, layout.dtype.name) != (shape, dtype):
        raise StorageError(
            f"array {name!r} of {str(folder)!r} is {layout.dtype.name} {layout.shape}, its manifest says {dtype} "
            f"{shape}; the job was changed, write it again"
        )
    return layout


@dataclass(frozen=True)
class Layout:
    """Layout of an array that `create` made: one chunk per entry of the first axis, ``shard`` of them per file."""

    # All numbers in its files are compared with one another before memory is allocated for it.

    path: Path
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    shard: int  # entries of the first axis in a file

    @classmethod
    def of(cls, path: Path) -> Layout:
        """Read ``zarr.json``."""
        said = parse_json(read_text(path / HEADER))
        try:
            shape, dtype = tuple(said["shape"]), np.dtype(said["data_type"])
            shards = tuple(said["chunk_grid"]["configuration"]["chunk_shape"])
            (sharding,) = said["codecs"]
            inner = sharding["configuration"]
            codecs = [codec["name"] for codec in inner["codecs"]], [codec["name"] for codec in inner["index_codecs"]]
            kinds = sharding["name"], said["chunk_grid"]["name"], inner["index_location"]
            chunk = tuple(inner["chunk_shape"])
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f"in zarr.json this is missing or malformed: {error}") from error
        sizes = (*shape, *shards)
        if not (shape and all(type(n) is int and n >= 0 for n in sizes) and 0 < shards[0] <= MOST_SHARD):
            raise ValueError(f"zarr.json says shape {shape} in files of {shards}")
        if chunk != (1, *shape[1:]) or shards[1:] != shape[1:] or dtype.kind not in "biuf":
            raise ValueError(f"an array {dtype} {shape} in chunks of {chunk} and files of {shards}; expected one chunk "
                             "per entry of the first axis")  # fmt: skip
        if kinds != ("sharding_indexed", "regular", "end") or codecs != (["bytes", "zstd"], ["bytes", "crc32c"]):
            raise ValueError(f"codecs {kinds}, {codecs}; expected those that this library writes")
        return cls(path, shape, dtype, shards[0])

    def file(self, number: int) -> Path:
        """Position of the entries from ``number`` times `shard` on."""
        return self.path.joinpath("c", str(number), *("0" for _ in self.shape[1:]))

    def entries(
        self, span: range, *, whole: bool = False, seen: Callable[[np.ndarray], object] = lambda part: None
    ) -> np.ndarray:
        """Entries of the first axis."""
        afford(len(span) * self.bytes, f"{self.path.name!r} of {str(self.path.parent)!r}")
        out = np.empty((len(span), *self.shape[1:]), self.dtype.newbyteorder("<"))
        if out.nbytes:
            begin = span.start
            for part in ahead(lambda one: self._unpack(one, whole, out[one.start - begin : one.stop - begin]),
                              self._pieces(span)):  # fmt: skip
                seen(part)
        return out.astype(self.dtype, copy=False)

    def parts(self, span: range | None = None, *, whole: bool = True) -> Iterator[np.ndarray]:
        """Entries in successive parts; the next ones are unpacked while the last one is used."""
        pieces = self._pieces(range(self.shape[0]) if span is None else span)
        most = max((len(piece) for piece in pieces), default=0)
        afford((threads() + 2) * most * self.bytes, f"{self.path.name!r} of {str(self.path.parent)!r}")
        if span is None:
            self._count_files()
        yield from ahead(lambda one: self._unpack(one, whole).astype(self.dtype, copy=False), pieces)

    def _pieces(self, span: range) -> list[range]:
        """Spans, each of one file, that a thread unpacks at a time."""
        each, found = max(1, PIECE // max(1, self.bytes)), []
        for number in range(span.start // self.shard, -(-span.stop // self.shard)):
            stop = min((number + 1) * self.shard, span.stop)
            starts = range(max(number * self.shard, span.start), stop, each)
            found += [range(start, min(start + each, stop)) for start in starts]
        return found

    def _unpack(self, span: range, whole: bool, out: np.ndarray | None = None) -> np.ndarray:
        out = np.empty((len(span), *self.shape[1:]), self.dtype.newbyteorder("<")) if out is None else out
        number = span.start // self.shard
        begin, file = number * self.shard, self.file(number)
        if whole and not is_file(file):
            self._count_files()
        decode(file, self.shard, range(span.start - begin, span.stop - begin), out, whole=whole)
        return out

    @property
    def bytes(self) -> int:
        """Bytes of an entry."""
        return prod(self.shape[1:]) * self.dtype.itemsize

    def _count_files(self) -> None:
        """Count the files, all of which were written; raises `FileNotFoundError` if some are missing."""
        expected = -(-self.shape[0] // self.shard)
        found = sum(len(files) for _, _, files in os.walk(self.path / "c"))
        if found != expected:
            raise FileNotFoundError(f"{found} of {expected} files of chunks are there")

"""Arrays of a job folder in Zarr v3: one chunk an entry of the first axis, many chunks a file."""

from __future__ import annotations

import os
from dataclasses import dataclass
from math import prod
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import Any

import numpy as np

from vamgpu.errors import StorageError
from vamgpu.storage.memory import afford
from vamgpu.storage.reading import is_file, open_file, parse_json, read_text

SHARD_BYTES = 64 * 2**20
SHARD_CHUNKS = 512
"""Limits of one file: few enough files for a job of many thousand frames, small enough to write and copy with ease."""
MOST_SHARD = 1 << 20
"""Entries of a file beyond which its index alone would be no index any more."""
ZSTANDARD = b"\x28\xb5\x2f\xfd"
ABSENT = np.uint64(2**64 - 1)
"""What Zarr's index says of an entry that is not there."""


def shard_length(shape: tuple[int, ...], itemsize: int) -> int:
    """Entries of the first axis a file holds."""
    one = max(1, int(np.prod(shape[1:], dtype=np.int64)) * itemsize)
    return max(1, min(shape[0], SHARD_CHUNKS, SHARD_BYTES // one))


def create(
    folder: Path, name: str, shape: tuple[int, ...], dtype: np.dtype, shards: tuple[int, ...], axes: tuple[str, ...]
) -> Any:
    """Create an empty array in a Zarr group, one chunk an entry of the first axis.

    Args:
        folder: The group.
        name: The array's name.
        shape: Its shape.
        dtype: Type of its values.
        shards: Shape of the files that hold the chunks.
        axes: Names of its axes.

    Returns:
        The Zarr array.
    """
    import zarr
    from zarr.codecs import ZstdCodec

    return zarr.open_group(folder, mode="a", zarr_format=3).create_array(
        name,
        shape=shape,
        dtype=dtype,
        chunks=(1, *shape[1:]),
        shards=shards,
        compressors=ZstdCodec(level=3, checksum=True),
        dimension_names=axes,
        config={"write_empty_chunks": True},  # so that a file that went missing is not taken for darkness
    )


def write(folder: Path, name: str, values: np.ndarray, axes: tuple[str, ...]) -> None:
    """Add an array to the Zarr group at ``folder``; raises `OSError` as the system does."""
    shards = (shard_length(values.shape, values.itemsize), *values.shape[1:])
    create(folder, name, values.shape, values.dtype, shards, axes)[...] = values


def read(folder: Path, name: str, shape: tuple[int, ...], dtype: str) -> np.ndarray:
    """A whole array. Raises `StorageError` where it is missing, damaged, or not as its record says."""
    return _read(folder, name, shape, dtype, range(shape[0]))


def read_one(folder: Path, name: str, shape: tuple[int, ...], dtype: str, index: int) -> np.ndarray:
    """One entry of the first axis. Raises `StorageError` as `read` does."""
    return _read(folder, name, shape, dtype, range(index, index + 1))[0]


def _read(folder: Path, name: str, shape: tuple[int, ...], dtype: str, span: range) -> np.ndarray:
    try:
        layout = Layout.of(folder / name)
        if (layout.shape, layout.dtype.name) == (shape, dtype):
            return layout.entries(span, whole=True)
    except StorageError:
        raise
    except Exception as error:  # noqa: BLE001 - damaged files raise whatever the codec that met them raises
        raise StorageError(
            f"cannot read array {name!r} of {str(folder)!r}: {type(error).__name__}: {error}; "
            "the job is damaged, write it again"
        ) from error
    raise StorageError(
        f"array {name!r} of {str(folder)!r} is {layout.dtype.name} {layout.shape}, its manifest says {dtype} {shape}; "
        "the job was changed, write it again"
    )


@dataclass(frozen=True)
class Layout:
    """How an array that `create` made lies on the disk: an entry of the first axis a chunk, ``shard`` of them a file.

    Everything that its files say is compared with one another before memory is taken for it.

    Args:
        path: Its folder.
        shape: Of the array.
        dtype: Of its entries.
        shard: Entries of the first axis in a file.
    """

    path: Path
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    shard: int

    @classmethod
    def of(cls, path: Path) -> Layout:
        """Read ``zarr.json``.

        Args:
            path: Folder of the array.

        Returns:
            The layout.

        Raises:
            OSError: The file cannot be read.
            ValueError: It is none that `create` writes.
        """
        said = parse_json(read_text(path / "zarr.json"))
        try:
            shape, dtype = tuple(said["shape"]), np.dtype(said["data_type"])
            shards = tuple(said["chunk_grid"]["configuration"]["chunk_shape"])
            (sharding,) = said["codecs"]
            inner = sharding["configuration"]
            codecs = [codec["name"] for codec in inner["codecs"]], [codec["name"] for codec in inner["index_codecs"]]
            kinds = sharding["name"], said["chunk_grid"]["name"], inner["index_location"]
            chunk = tuple(inner["chunk_shape"])
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f"zarr.json lacks or garbles {error}") from error
        sizes = (*shape, *shards)
        if not (shape and all(type(n) is int and n >= 0 for n in sizes) and 0 < shards[0] <= MOST_SHARD):
            raise ValueError(f"zarr.json says shape {shape} in files of {shards}")
        if chunk != (1, *shape[1:]) or shards[1:] != shape[1:] or dtype.kind not in "biuf":
            raise ValueError(f"an array {dtype} {shape} in chunks of {chunk} and files of {shards}; expected one chunk "
                             "an entry of the first axis")  # fmt: skip
        if kinds != ("sharding_indexed", "regular", "end") or codecs != (["bytes", "zstd"], ["bytes", "crc32c"]):
            raise ValueError(f"codecs {kinds}, {codecs}; expected those that this library writes")
        return cls(path, shape, dtype, shards[0])

    def file(self, number: int) -> Path:
        """Where the entries from ``number`` times `shard` on are.

        Args:
            number: Of the file.

        Returns:
            Its path.
        """
        return self.path.joinpath("c", str(number), *("0" for _ in self.shape[1:]))

    def entries(self, span: range, *, whole: bool = False) -> np.ndarray:
        """Entries of the first axis.

        Args:
            span: Which; a step of 1.
            whole: Whether every file of the array must be there, and every entry in it.

        Returns:
            The array [entry, …].

        Raises:
            OSError: A file is missing or cannot be read.
            ValueError: A file says of its entries what the array does not.
            StorageError: The entries take more memory than the budget.
        """
        import zarr

        afford(len(span) * self.bytes, f"{self.path.name!r} of {str(self.path.parent)!r}")
        if whole:
            self._count_files()
        for number in range(span.start // self.shard, -(-span.stop // self.shard)):
            first, end = number * self.shard, (number + 1) * self.shard
            self._check_file(number, range(max(first, span.start), min(end, span.stop)), whole)
        array = zarr.open_array(self.path, mode="r", zarr_format=3)
        return np.asarray(array[span.start : span.stop])

    @property
    def bytes(self) -> int:
        """Bytes of an entry."""
        return prod(self.shape[1:]) * self.dtype.itemsize

    def _count_files(self) -> None:
        """Zarr reads a file that is missing as zeros; here every file was written, so count them."""
        expected = -(-self.shape[0] // self.shard)
        found = sum(len(files) for _, _, files in os.walk(self.path / "c"))
        if found != expected:
            raise FileNotFoundError(f"{found} of {expected} files of chunks are there")

    def _check_file(self, number: int, span: range, whole: bool) -> None:
        """Raise `ValueError` where entries of a file unpack to another size than the array's, as bombs do.

        At the end of a file stand where each entry begins and how long it is, and a check sum; an entry begins with
        Zstandard's header, which says how long it is unpacked.
        """
        if not is_file(self.file(number)):  # Zarr would read darkness
            raise FileNotFoundError(f"file {number} is missing, or no file")
        with open_file(self.file(number)) as file, mmap(file.fileno(), 0, access=ACCESS_READ) as data:
            begin = len(data) - 16 * self.shard - 4
            if begin < 0:
                raise ValueError(f"file {number} has {len(data)} bytes, too few for {self.shard} entries")
            first = begin + 16 * (span.start - number * self.shard)
            index = np.frombuffer(data[first : first + 16 * len(span)], "<u8").reshape(-1, 2)
            there = index[(index != ABSENT).any(axis=1)]
            if whole and len(there) < len(span):
                raise ValueError(f"file {number} lacks {len(span) - len(there)} of {len(span)} entries")
            if len(there) and (int(there.max()) > begin or int(there.sum(axis=1).max()) > begin):
                raise ValueError(f"file {number} has entries beyond its end")
            for offset, _ in there.tolist():
                if (found := _unpacked(data[offset : offset + 18])) != self.bytes:
                    raise ValueError(f"an entry of file {number} unpacks to {found} bytes; expected {self.bytes}")


def _unpacked(head: bytes) -> int | None:
    """Bytes that a Zstandard frame says it unpacks to (RFC 8878, 3.1.1.1); None where it does not say."""
    if len(head) < 6 or head[:4] != ZSTANDARD:
        return None
    single, length = head[4] >> 5 & 1, (0, 2, 4, 8)[head[4] >> 6]
    length = length or single
    start = 6 - single + (0, 1, 2, 4)[head[4] & 3]
    return int.from_bytes(head[start : start + length], "little") + (256 if length == 2 else 0) if length else None

"""Arrays of a job folder in Zarr v3: one chunk an entry of the first axis, many chunks a file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from vamgpu.errors import StorageError

SHARD_BYTES = 64 * 2**20
SHARD_CHUNKS = 512
"""Limits of one file: few enough files for a job of many thousand frames, small enough to write and copy with ease."""


def shard_length(shape: tuple[int, ...], itemsize: int) -> int:
    """Entries of the first axis a file holds."""
    one = max(1, int(np.prod(shape[1:], dtype=np.int64)) * itemsize)
    return max(1, min(shape[0], SHARD_CHUNKS, SHARD_BYTES // one))


def write(folder: Path, name: str, values: np.ndarray, axes: tuple[str, ...]) -> None:
    """Add an array to the Zarr group at ``folder``; raises `OSError` as the system does."""
    import zarr
    from zarr.codecs import ZstdCodec

    group = zarr.open_group(folder, mode="a", zarr_format=3)
    array = group.create_array(
        name,
        shape=values.shape,
        dtype=values.dtype,
        chunks=(1, *values.shape[1:]),
        shards=(shard_length(values.shape, values.itemsize), *values.shape[1:]),
        compressors=ZstdCodec(level=3, checksum=True),
        dimension_names=axes,
        config={"write_empty_chunks": True},  # so that a file that went missing is not taken for darkness
    )
    array[...] = values


def read(folder: Path, name: str, shape: tuple[int, ...], dtype: str) -> np.ndarray:
    """A whole array. Raises `StorageError` where it is missing, damaged, or not as its record says."""
    return _read(folder, name, shape, dtype, slice(None))


def read_one(folder: Path, name: str, shape: tuple[int, ...], dtype: str, index: int) -> np.ndarray:
    """One entry of the first axis. Raises `StorageError` as `read` does."""
    return _read(folder, name, shape, dtype, index)


def _read(folder: Path, name: str, shape: tuple[int, ...], dtype: str, index: Any) -> np.ndarray:
    import zarr

    try:
        array = zarr.open_array(folder / name, mode="r", zarr_format=3)
        found = (array.shape, np.dtype(array.dtype).name)
        _all_there(folder / name, array.shape, array.shards)
        values = np.asarray(array[index])
    except Exception as error:  # noqa: BLE001 - damaged files raise whatever the codec that met them raises
        raise StorageError(
            f"cannot read array {name!r} of {str(folder)!r}: {type(error).__name__}: {error}; "
            "the job is damaged, write it again"
        ) from error
    if found != (shape, dtype):
        raise StorageError(
            f"array {name!r} of {str(folder)!r} is {found[1]} {found[0]}, its manifest says {dtype} {shape}; "
            "the job was changed, write it again"
        )
    return values


def _all_there(folder: Path, shape: tuple[int, ...], shards: tuple[int, ...] | None) -> None:
    """Zarr reads a file that is missing as zeros; here every file was written, so count them."""
    wanted = -(-shape[0] // shards[0]) if shards else 0
    found = sum(file.is_file() for file in (folder / "c").rglob("*"))
    if found != wanted:
        raise FileNotFoundError(f"{found} of {wanted} files of chunks are there")

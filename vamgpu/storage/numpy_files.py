"""NumPy's files; headers are compared with the size of the file before memory is allocated."""

from __future__ import annotations

import os
from math import prod
from pathlib import Path
from tokenize import TokenError
from typing import Any, BinaryIO
from zipfile import BadZipFile
from zlib import error as DeflateError

import numpy as np
from numpy.lib import format as npy

from vamgpu.errors import StorageError
from vamgpu.storage.memory import afford
from vamgpu.storage.reading import open_file
from vamgpu.storage.zips import open_zip

HEADERS = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}


def map_npy(path: str | Path) -> np.ndarray:
    """The array of an NPY file, mapped from the disk: only the parts used are read."""
    try:
        with open_file(path) as file:
            shape, fortran, dtype = _header(file, os.fstat(file.fileno()).st_size, str(path))
            if not prod(shape):
                return np.empty(shape, dtype)
            order = "F" if fortran else "C"
            return np.memmap(file, dtype, "r", file.tell(), shape, order)  # pyright: ignore[reportArgumentType]
    except StorageError:
        raise
    except (OSError, ValueError, OverflowError) as error:
        raise _unread(path, error) from error


def read_npz(path: str | Path) -> dict[str, np.ndarray]:
    """The arrays of an NPZ file by name."""
    found: dict[str, np.ndarray] = {}
    try:
        with open_file(path) as file, open_zip(file) as archive:
            members = archive.infolist()
            afford(sum(member.file_size for member in members), f"{str(path)!r} unpacked")
            for member in members:
                name = f"{member.filename!r} of {str(path)!r}"
                with archive.open(member) as packed:
                    _header(packed, member.file_size, name)  # type: ignore[arg-type]
                with archive.open(member) as packed:
                    found[member.filename.removesuffix(".npy")] = npy.read_array(packed, allow_pickle=False)
    except StorageError:
        raise
    except (OSError, ValueError, OverflowError, EOFError, BadZipFile, DeflateError) as error:
        raise _unread(path, error) from error
    return found


def _header(file: BinaryIO, length: int, name: str) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Shape, order (C or Fortran) and type; the file position is then at the first number."""
    try:
        version = npy.read_magic(file)
        if version not in HEADERS:
            raise ValueError(f"version {version}, expected 1.0 or 2.0")
        shape, fortran, dtype = HEADERS[version](file)
    except (SyntaxError, TypeError, RecursionError, MemoryError, TokenError) as error:  # as invalid headers cause
        raise ValueError(f"a damaged header ({type(error).__name__})") from error
    claim, held = prod(shape) * dtype.itemsize, length - file.tell()
    if dtype.hasobject or any(n < 0 for n in shape) or claim > held:
        raise StorageError(
            f"{name} declares {dtype} {shape} but has {held} bytes for it; expected all of its numbers, plain: "
            "write the file again"
        )
    return shape, fortran, dtype


def _unread(path: str | Path, error: Exception) -> StorageError:
    said = getattr(error, "strerror", None) or error
    return StorageError(f"cannot read {str(path)!r}: {said}; expected a NumPy file: write it again")

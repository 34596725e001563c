"""Pickles of arrays and plain values, read without executing anything that they name.

Its classes become plain sets of attributes, its arrays are assembled from bytes; any other call is an error.
"""

from __future__ import annotations

import pickle
import pickletools
from io import BytesIO
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from vamgpu.errors import StorageError
from vamgpu.storage.memory import afford
from vamgpu.storage.reading import read_bytes

MOST_BYTES = 16_000_000_000
MOST_STEPS = 5_000_000  # limit of a pickle's instructions; one of arrays has some hundreds
NUMBERS = "biufc"
ROOTS = ("numpy.core.multiarray", "numpy._core.multiarray")
NUMERIC = ("numpy.core.numeric", "numpy._core.numeric")


class Bag:
    """An object's class name and attributes."""

    # *given: The constructor's arguments.

    name: str = ""

    def __init__(self, *given: Any) -> None:
        self.given = given

    def __setstate__(self, state: Any) -> None:
        parts = state if isinstance(state, tuple) else (state,)
        for part in parts:
            if isinstance(part, dict):
                self.__dict__.update({str(key): value for key, value in part.items()})

    def get(self, name: str) -> Any:
        return self.__dict__.get(name)


class _Type:
    """A NumPy type, only from its code and its byte order."""

    def __init__(self, word: Any, *_: Any) -> None:
        self.word, self.order = word, "="

    def __setstate__(self, state: Any) -> None:
        if state[1] not in ("<", ">", "|", "=") or any(part not in (None, ()) for part in state[2:5]):
            raise ValueError("a type of several fields, expected plain numbers")
        self.order = state[1]

    def dtype(self) -> np.dtype[Any]:
        """The type; raises `ValueError` for a type that is not a plain number."""
        found = np.dtype(str(self.word)).newbyteorder(self.order)  # type: ignore[arg-type]
        if found.kind not in NUMBERS or found.hasobject:
            raise ValueError(f"an array of {found}, expected plain numbers")
        return found


class _Array:
    """An array, assembled from its bytes."""

    values: np.ndarray

    def __setstate__(self, state: Any) -> None:
        _, shape, kind, fortran, data = state
        self.values = _array(data, kind, shape, "F" if fortran else "C")


def _array(data: Any, kind: Any, shape: Any, order: Any = "C") -> np.ndarray:
    dtype, sizes = kind.dtype(), tuple(shape) if isinstance(shape, (tuple, list)) else (shape,)
    if not (all(type(n) is int and n >= 0 for n in sizes) and isinstance(data, (bytes, bytearray, memoryview))):
        raise ValueError(f"an array of shape {sizes}, expected its bytes")
    if prod(sizes) * dtype.itemsize != memoryview(data).nbytes:
        raise ValueError(f"{memoryview(data).nbytes} bytes for {dtype} {sizes}")
    return np.frombuffer(data, dtype).reshape(sizes, order="F" if order == "F" else "C")


def _from_bytes(data: Any, kind: Any, shape: Any, order: Any = "C", axes: Any = None) -> Any:
    made = _Array()
    made.values = _array(data, kind, shape, order)
    if order == "K" and axes is not None:  # of an array that was stored with another order of its axes
        made.values = made.values.transpose(axes)
    return made


def _bytes(data: Any = b"", *_: Any) -> bytes:
    if not isinstance(data, (bytes, bytearray)):  # a number would request memory
        raise ValueError(f"bytes made of {type(data).__name__}")
    return bytes(data)


def _encoded(text: str, encoding: str = "latin1") -> bytes:
    if encoding not in ("latin1", "latin-1", "utf-8"):
        raise ValueError(f"text in {encoding}")
    return text.encode(encoding)


class _Unpickler(pickle.Unpickler):
    """Unpickles the functions that NumPy's arrays use, and other classes of some packages as sets of attributes."""

    def __init__(self, data: bytes, packages: tuple[str, ...]) -> None:
        super().__init__(BytesIO(data))
        self._packages = packages

    def find_class(self, module: str, name: str) -> Any:
        known: dict[tuple[str, str], Any] = {
            ("numpy", "ndarray"): _Array,
            ("numpy", "dtype"): _Type,
            ("collections", "OrderedDict"): dict,
            ("builtins", "bytearray"): _bytes,
            ("_codecs", "encode"): _encoded,
            ("copyreg", "_reconstructor"): lambda cls, *_: cls(),
            ("copy_reg", "_reconstructor"): lambda cls, *_: cls(),
            ("builtins", "object"): object,
            ("__builtin__", "object"): object,
            **{(root, "_reconstruct"): lambda *_: _Array() for root in ROOTS},
            **{(root, "scalar"): lambda kind, data=b"": _array(data, kind, (1,))[0].item() for root in ROOTS},
            **{(root, "_frombuffer"): _from_bytes for root in NUMERIC},
        }
        if (module, name) in known:
            return known[module, name]
        if module.split(".")[0] in self._packages:
            return type("Bag", (Bag,), {"name": name})
        raise pickle.UnpicklingError(f"it would call {module}.{name}")


def read_pickle(path: str | Path, packages: tuple[str, ...] = ()) -> Any:
    """The contents of a pickle, without executing it."""
    try:
        data = read_bytes(path, MOST_BYTES)
        afford(3 * len(data), f"the pickle {str(path)!r}")
        _weigh(data)
        return _opened(_Unpickler(data, packages).load())
    except StorageError:
        raise
    except OSError as error:
        raise StorageError(f"cannot read {str(path)!r}: {error.strerror or error}; check the path") from error
    except Exception as error:  # noqa: BLE001 - a malicious pickle can raise anything
        raise StorageError(
            f"{str(path)!r} is not a pickle of arrays and plain values ({type(error).__name__}: {error}); nothing of "
            "it was run: save the array with numpy.save and import that"
        ) from error


def _weigh(data: bytes) -> None:
    """Before reading, reject sizes and numbers in a step that would take too much memory."""
    steps = 0
    for steps, (code, given, _) in enumerate(pickletools.genops(data), 1):
        if steps > MOST_STEPS:
            raise ValueError(f"more than {MOST_STEPS:,} steps")
        if (
            "PUT" in code.name and not 0 <= int(given or 0) <= steps
        ):  # its memory is a list as long as the greatest number
            raise ValueError(f"a memory of {given} places after {steps} steps")
        if code.name in ("PERSID", "BINPERSID", "EXT1", "EXT2", "EXT4", "NEXT_BUFFER"):
            raise ValueError(f"a step {code.name}")


def _opened(value: Any, seen: dict[int, Any] | None = None) -> Any:
    """The same with arrays in place of their parts; each part is visited only once."""
    seen = {} if seen is None else seen
    if isinstance(value, _Array):
        return value.values
    if id(value) in seen or not isinstance(value, (Bag, dict, list, tuple)):
        return seen.get(id(value), value)
    seen[id(value)] = value
    if isinstance(value, (list, tuple)):
        seen[id(value)] = made = type(value)(_opened(part, seen) for part in value)
        return made
    table = value.__dict__ if isinstance(value, Bag) else value
    for key, part in list(table.items()):
        table[key] = _opened(part, seen)
    return value
